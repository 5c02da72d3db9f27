"""Chaos: storms repeat, hold, and find out what they are there for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from agent.exchange.log import Log
from deploy.chaos import runs
from deploy.chaos.byzantine import Lies
from deploy.chaos.case import CALM, ChaosCase, case
from deploy.chaos.invariants import Violation, Watcher
from deploy.chaos.runs import Verdict, shrink, weather
from deploy.commands.main import app
from deploy.run.in_memory import MemoryRun
from deploy.scenario import plan as plans
from protocol.grid import UNKNOWN
from protocol.memory_bus import MemoryHub
from protocol.messages import OutgoingFrame, RobotFrames, pack, unpack

SMALL = [6, 11, 15]
"""Seeds of small and short storms."""


def test_a_storm_follows_from_its_seed() -> None:
    drawn = [case(seed) for seed in range(60)]
    assert drawn == [case(seed) for seed in range(60)]
    assert len({each.scenario.to_toml() for each in drawn}) == 60
    kinds = {fault.kind for each in drawn for fault in each.scenario.fault}
    assert kinds == {"kill", "restart", "stop", "mute", "deaf"}
    assert any(each.byzantine for each in drawn)
    assert any(each.scenario.change for each in drawn)
    for each in drawn:
        assert all(fault.step + fault.steps <= CALM for fault in each.scenario.fault)


@pytest.mark.parametrize("seed", SMALL)
def test_storms_hold_and_repeat_byte_for_byte(seed: int) -> None:
    once, twice = (weather(case(seed), again=number and seed == SMALL[0]) for number in range(2))
    assert once.failure == twice.failure == ""
    assert once.digest == twice.digest
    assert once.known >= 0.97


def sabotaged(drawn: ChaosCase, wrong: str) -> None:
    """Run a storm in which robots go wrong after step 25."""
    plan = plans.make(drawn.scenario)
    watcher = Watcher(plan, ())
    under_way = MemoryRun(plan)
    for step in under_way.steps():
        for agent in under_way.agents:
            robot = agent.robot
            if robot is None or agent.done:
                continue
            if step == 25:
                known = tuple(np.argwhere(robot.own != UNKNOWN)[0])
                if wrong == "forgets":
                    robot.own[known] = UNKNOWN
                if wrong == "invents":
                    robot.own[known] ^= 3
                if wrong == "overrules":
                    robot.planning[known] ^= 3
                if wrong == "loses":
                    robot.session.logs[:] = [Log() for _ in robot.session.logs]
            watcher.inspect(step, robot)
    watcher.conclude(under_way.records)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ("forgets", "does not know any more what it has seen"),
        ("invents", "has seen what is not so"),
        ("overrules", "plans on cells otherwise than it has seen them"),
        ("loses", "units of map"),
    ],
)
def test_a_robot_that_goes_wrong_is_found_out(wrong: str, words: str) -> None:
    with pytest.raises(Violation, match=words):
        sabotaged(case(SMALL[1]), wrong)


def test_what_a_failure_does_not_need_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails_with_a_kill(drawn: ChaosCase, *, again: bool = False) -> Verdict:
        killed = [fault for fault in drawn.scenario.fault if fault.kind == "kill"]
        return Verdict(drawn, f"{len(killed)} killed" if killed else "", again=again)

    monkeypatch.setattr(runs, "weather", fails_with_a_kill)
    full = next(each for each in map(case, range(99)) if each.byzantine and fails_with_a_kill(each).failure)
    least = shrink(fails_with_a_kill(full)).case
    assert [fault.kind for fault in least.scenario.fault] == ["kill"]
    assert least.byzantine == ()


def test_liars_lie_on_the_radio_alone_and_by_their_seed() -> None:
    def heard(seed: int) -> list[bytes]:
        hub = MemoryHub("run")
        relay, bus = hub.join("relay"), Lies(seed, (1,))("r1", hub.join("r1"))
        relay.receive()
        for number in range(99):
            said = RobotFrames(1, 0, "offers", frames=[OutgoingFrame(0, bytes([0xF0, number]))])
            bus.put(hub.keys.radio_tx("r1"), pack(said))
            bus.put(hub.keys.control_tx("r1"), bytes([number]))
        return [message.payload for message in iter(relay.receive, None)]

    said = heard(1)
    assert said == heard(1) != heard(2)
    assert said[1::2] == [bytes([number]) for number in range(99)]
    frames = [unpack(payload).frames for payload in said[::2]]
    lies = sum(frame.payload != bytes([0xF0, number]) for number, (frame,) in enumerate(frames))
    assert 10 < lies < 40


def test_the_command_says_what_held_and_how_to_repeat_what_did_not(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    command = ["chaos", "--runs", "1", "--seed", str(SMALL[2]), "--out", str(tmp_path)]
    good = CliRunner().invoke(app, command)
    assert good.exit_code == 0
    assert "1 of 1 storms hold" in good.stdout
    monkeypatch.setattr("deploy.chaos.invariants.ENOUGH", 2.0)
    bad = CliRunner().invoke(app, command)
    assert bad.exit_code == 1
    assert f"again: murmur chaos --runs 1 --seed {SMALL[2]}" in bad.output
    (left,) = tmp_path.glob("chaos-*.toml")
    assert "those who live know" in left.read_text()
