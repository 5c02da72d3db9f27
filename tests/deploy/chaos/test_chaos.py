"""Chaos: cases are deterministic, pass, and detect violated invariants."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from agent.replication.log import Log
from deploy.chaos import runs
from deploy.chaos.byzantine import HostileRadios
from deploy.chaos.case import CALM, NARROW_BANDWIDTHS, ChaosCase, case
from deploy.chaos.invariants import InvariantChecker, InvariantError
from deploy.chaos.runs import Verdict, run_case, shrink
from deploy.commands.app import app
from deploy.run.in_memory import MemoryRun
from deploy.scenario import plan as plans
from protocol.grid import UNKNOWN
from protocol.memory_bus import MemoryHub
from protocol.message_codec import pack, unpack
from protocol.messages import OutgoingFrame, RobotFrames

pytestmark = pytest.mark.slow

SMALL = [6, 11, 15, 75]
"""Seeds of small and short cases."""
NARROW = [155, 85]
"""Seeds of short cases on a narrow medium, with exact maps and with a tolerance."""


def test_a_case_follows_from_its_seed() -> None:
    drawn = [case(seed) for seed in range(60)]
    assert drawn == [case(seed) for seed in range(60)]
    assert len({each.scenario.to_toml() for each in drawn}) == 60
    kinds = {fault.kind for each in drawn for fault in each.scenario.fault}
    assert kinds == {"kill", "restart", "stop", "mute", "deaf"}
    assert any(each.byzantine for each in drawn)
    assert any(each.false_map for each in drawn)
    assert not any(each.false_map and each.scenario.map_encoding == "polygons" for each in drawn)
    tolerant = [each for each in drawn if each.scenario.tolerance]
    assert {each.scenario.map_encoding for each in tolerant} == {"predictive"}
    assert not any(each.false_map for each in tolerant)
    assert any(each.scenario.change for each in drawn)
    assert any(each.scenario.bandwidth in NARROW_BANDWIDTHS for each in drawn)
    assert any(each.heavy for each in drawn)
    assert {cut.reset for each in drawn for cut in each.cuts} == {False, True}
    for each in drawn:
        assert all(fault.step + fault.steps <= CALM for fault in each.scenario.fault)


def test_a_seed_names_the_same_case_in_all_versions() -> None:
    """Reports of failures name seeds; `deploy.chaos.case.case` says how to add a fault."""
    drawn = [case(seed) for seed in range(60)]
    faults = [(fault.step, fault.robot, fault.kind) for each in drawn for fault in each.scenario.fault]
    hostile = [(each.byzantine, each.flipped, each.false_map, each.heavy, len(each.cuts)) for each in drawn]
    settings = [(each.scenario.map, each.scenario.bandwidth, each.scenario.strategy) for each in drawn]
    text = repr((faults, hostile, settings))
    assert hashlib.sha256(text.encode()).hexdigest()[:12] == "6038f9f95c7d"


def test_cases_on_a_narrow_medium_have_exact_maps_or_a_tolerance() -> None:
    exact, tolerant = (case(seed).scenario for seed in NARROW)
    assert {exact.bandwidth, tolerant.bandwidth} <= set(NARROW_BANDWIDTHS)
    assert exact.tolerance == 0 < tolerant.tolerance


@pytest.mark.parametrize("seed", [*SMALL, *NARROW])
def test_cases_pass_and_are_deterministic(seed: int) -> None:
    first, second = (
        run_case(case(seed), as_processes=bool(number) and seed == SMALL[0]) for number in range(2)
    )
    assert first.failure == second.failure == ""
    assert first.digest == second.digest
    assert first.known >= 0.97


@pytest.mark.parametrize(("seed", "cuts"), [(34, 2), (86, 5)], ids=["robots", "relay"])
def test_cut_connections_and_long_messages_do_not_change_a_run_of_processes(seed: int, cuts: int) -> None:
    drawn = case(seed)
    assert drawn.heavy
    assert len(drawn.cuts) == cuts
    assert run_case(drawn, as_processes=True).failure == ""


def run_with_defect(drawn: ChaosCase, defect: str) -> None:
    """Run a case in which robots fail after step 25."""
    plan = plans.make(drawn.scenario)
    checker = InvariantChecker(plan, ())
    run = MemoryRun(plan)
    first_known = {}
    for step in run.steps():
        for agent in run.agents:
            robot = agent.robot
            if robot is None or agent.done:
                continue
            if step == 1:
                first_known[robot.settings.robot] = tuple(np.argwhere(robot.own != UNKNOWN)[0])
            if step == 25:
                known = first_known[robot.settings.robot]
                if defect == "forgets":
                    robot.own[known] = UNKNOWN
                if defect == "invents":
                    robot.own[known] ^= 3
                if defect == "overrules":
                    robot.planning[known] ^= 3
                if defect == "loses":
                    robot.replication.logs[:] = [Log() for _ in robot.replication.logs]
            checker.check(step, robot)
    checker.check_end(run.records)


@pytest.mark.parametrize(
    ("defect", "message"),
    [
        ("forgets", "a known cell has become unknown"),
        ("invents", "own grid differs from the world"),
        ("overrules", "planning grid differs from own grid"),
        ("loses", "log of map"),
    ],
)
def test_a_defective_robot_is_detected(defect: str, message: str) -> None:
    with pytest.raises(InvariantError, match=message):
        run_with_defect(case(SMALL[1]), defect)


def test_shrinking_keeps_only_the_faults_that_a_failure_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails_with_a_kill(drawn: ChaosCase, *, as_processes: bool = False) -> Verdict:
        killed = [fault for fault in drawn.scenario.fault if fault.kind == "kill"]
        return Verdict(drawn, f"{len(killed)} killed" if killed else "", as_processes=as_processes)

    monkeypatch.setattr(runs, "run_case", fails_with_a_kill)
    full = next(each for each in map(case, range(99)) if each.byzantine and fails_with_a_kill(each).failure)
    smallest = shrink(fails_with_a_kill(full)).case
    assert [fault.kind for fault in smallest.scenario.fault] == ["kill"]
    assert smallest.byzantine == ()


def test_byzantine_robots_change_only_radio_frames_and_follow_their_seed() -> None:
    def received(seed: int) -> list[bytes]:
        hub = MemoryHub("run")
        relay, bus = hub.join("relay"), HostileRadios(seed, (1,))("r1", hub.join("r1"))
        relay.receive()
        for number in range(99):
            message = RobotFrames(1, 0, "offers", frames=[OutgoingFrame(0, bytes([0xF0, number]))])
            bus.put(hub.keys.radio_tx("r1"), pack(message))
            bus.put(hub.keys.control_tx("r1"), bytes([number]))
        return [message.payload for message in iter(relay.receive, None)]

    messages = received(1)
    assert messages == received(1) != received(2)
    assert messages[1::2] == [bytes([number]) for number in range(99)]
    frames = [unpack(payload).frames for payload in messages[::2]]
    replaced = sum(frame.payload != bytes([0xF0, number]) for number, (frame,) in enumerate(frames))
    assert 10 < replaced < 40


def test_the_command_reports_failures_and_how_to_repeat_them(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    command = ["chaos", "--runs", "1", "--seed", str(SMALL[2]), "--out", str(tmp_path)]
    good = CliRunner().invoke(app, command)
    assert good.exit_code == 0
    assert "1 of 1 runs passed" in good.stdout
    monkeypatch.setattr("deploy.chaos.invariants.MIN_KNOWN", 2.0)
    bad = CliRunner().invoke(app, command)
    assert bad.exit_code == 1
    assert f"repeat: murmur chaos --runs 1 --seed {SMALL[2]}" in bad.output
    (left,) = tmp_path.glob("chaos-*.toml")
    assert "the living robots know" in left.read_text()
