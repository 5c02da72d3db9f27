"""Imperfect radios: with loss, delay, damage or partitions, robots end with the same maps, only later."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from deploy.run.exploration import explore
from deploy.run.result import Result
from deploy.scenario.scenario import load
from netshaper.frame_log import BYTES, VERDICT
from netshaper.ledger import CAUSES, EVERYONE, FIRST_ON_AIR, KIND_NUMBER
from protocol.grid import FREE
from tests.netshaper.network import Step
from tests.system.team import Cell, Team, small_plan

FLOOR: dict[str, Any] = {
    "map": "office", "map_options": {"width_m": 10.0, "height_m": 10.0}, "bus": "memory", "sensor_range": 3.0,
    "robots": 3, "seed": 4, "steps": 1500,
}  # fmt: skip

APART = [{"first": 10, "last": 109, "groups": [[0], [1, 2]]}]
TROUBLES: dict[str, dict[str, Any]] = {
    "loss": {"loss": 0.2},
    "delay": {"delay": 3},
    "partition": {"partition": APART},
    "all at once": {
        "loss": 0.1, "jitter": 2, "duplication": 0.2, "bit_errors": 0.0005, "frame_bytes": 60, "reuse": True,
        "burst_every": 40.0,
    },
}  # fmt: skip
WAYS = [
    (map_encoding, dissemination)
    for map_encoding in ("scans", "polygons", "predictive")
    for dissemination in ("backoff", "gossip")
]


@cache
def tour() -> list[dict[int, Cell]]:
    """The cells of three robots in each step, the same for every map encoding."""
    team = Team(small_plan(side_m=10.0, map_encoding="scans", robots=3, seed=4))
    cells: list[dict[int, Cell]] = []
    while len(cells) < 40 and not any(move.explored for move in team.moves.values()):
        team.explore(team.step + 1)
        cells.append(dict(team.world.cells))
    return cells


def walk(map_encoding: str, dissemination: str, radio: dict[str, Any], more: int) -> Team:
    """Robots that drive the tour and then stand still for `more` steps."""
    settings = {"polygons": {"lazy": False}} if map_encoding == "polygons" else {}
    team = Team(
        small_plan(
            side_m=10.0,
            map_encoding=map_encoding,
            dissemination=dissemination,
            radio=radio,
            robots=3,
            seed=4,
            bandwidth="unlimited",
            **settings,
        )
    )
    for cells in [*tour(), *more * tour()[-1:]]:
        team.stand(cells)
    return team


@pytest.mark.parametrize(("map_encoding", "dissemination"), WAYS)
def test_all_robots_end_with_the_same_maps_as_on_a_perfect_radio(
    map_encoding: str, dissemination: str
) -> None:
    perfect = walk(map_encoding, dissemination, {}, 90)
    for trouble in ("loss", "delay", "partition"):
        team = walk(map_encoding, dissemination, TROUBLES[trouble], 90)
        for robot, other in zip(team.robots, perfect.robots, strict=True):
            assert np.array_equal(robot.planning, other.planning), trouble
            for map_id in range(3):
                held = team.held(robot.settings.robot, map_id)
                same = held == perfect.held(robot.settings.robot, map_id)
                assert same, trouble


@pytest.mark.parametrize("trouble", ["loss", "all at once"])
@pytest.mark.parametrize(("map_encoding", "dissemination"), WAYS)
def test_a_team_explores_all_reachable_cells_on_any_radio(
    map_encoding: str, dissemination: str, trouble: str
) -> None:
    result = explore(
        load(
            None,
            FLOOR
            | {"map_encoding": map_encoding, "dissemination": dissemination, "radio": TROUBLES[trouble]},
        ),
        keep=False,
    )
    perfect = explored(map_encoding, dissemination)
    assert result.summary["finished"]
    seen = result.maps["team"] == FREE
    assert (seen == (perfect.maps["team"] == FREE)).all()
    assert result.summary["coverage"] == perfect.summary["coverage"]
    assert result.summary["over_budget_steps"] == result.summary["protocol_errors"] == 0
    books_balance(result)


@cache
def explored(map_encoding: str, dissemination: str) -> Result:
    return explore(
        load(None, FLOOR | {"map_encoding": map_encoding, "dissemination": dissemination}), keep=False
    )


def books_balance(result: Result) -> None:
    """Each carried unicast frame is received once, lost, damaged or dropped; each frame has its checksum."""
    rows = result.records.ledger()
    carried, cause = rows["carried"] == 1, rows["cause"]
    assert (carried == ((cause == 0) | (cause >= FIRST_ON_AIR))).all()
    unicast = carried & (rows["receiver"] != EVERYONE)
    assert (rows["received_by"][unicast] == (cause[unicast] == 0)).all()
    assert (rows["received_by"][cause != 0] == 0).all()
    options = result.plan.scenario.radio
    sums = carried & (rows["kind"] == KIND_NUMBER["sum"])
    assert sums.any() == options.sums
    if options.frame_bytes and not options.perfect:
        frames = rows["packets"][sums].sum()
        assert rows["bytes"][carried].sum() <= frames * options.frame_bytes


@pytest.mark.parametrize("dissemination", ["backoff", "thesis", "gossip"])
@pytest.mark.parametrize("map_encoding", ["scans", "polygons", "predictive", "cells", "zstd-maps"])
@pytest.mark.parametrize("loss", [0.0, 0.1])
def test_no_transmitted_frame_exceeds_the_frame_limit(
    map_encoding: str, dissemination: str, loss: float
) -> None:
    radio = {"frame_bytes": 20, "loss": loss, "checksums": loss > 0}
    team = Team(
        small_plan(
            side_m=10.0,
            map_encoding=map_encoding,
            dissemination=dissemination,
            radio=radio,
            bandwidth=400,
            seed=1,
        )
    )
    frames: list[int] = []

    def note(rows: Any) -> None:
        frames.extend(rows[rows[:, VERDICT] == 0, BYTES].tolist())

    listen(team, note)
    team.explore(60)
    assert frames
    assert max(frames) <= 20
    assert not (team.ledger()["cause"] == CAUSES.index("protocol")).any()


def listen(team: Team, note: Any) -> None:
    """Call `note` with the columns of each step's frames."""
    take = team._network._take

    def taking(step: Step) -> None:
        for account in team._network.radio.accounts:
            note(account.log.rows())
        take(step)

    team._network._take = taking  # type: ignore[method-assign]


@pytest.mark.parametrize("dissemination", ["backoff", "gossip"])
def test_the_digest_is_the_same_on_both_buses(dissemination: str) -> None:
    radio = TROUBLES["all at once"] | {
        "model": "log-distance",
        "shadowing_db": 6.0,
        "partition": APART,
        "delay": 1,
        "duty_cycle": 0.002,
    }
    scenario = FLOOR | {
        "map_encoding": "predictive",
        "dissemination": dissemination,
        "radio": radio,
        "bandwidth": 200,
        "steps": 60,
    }
    runs = [explore(load(None, scenario | {"bus": bus}), keep=False) for bus in ("memory", "zenoh")]
    assert runs[0].summary["digest"] == runs[1].summary["digest"]
    assert {"loss", "damaged"} <= set(runs[0].summary["undelivered"])


def test_with_spatial_reuse_two_ends_of_a_corridor_transmit_at_once() -> None:
    most_bytes = {}
    for reuse in (False, True):
        radio = {"reuse": reuse, "checksums": True}
        plan = small_plan(
            side_m=10.0, map_encoding="scans", robots=4, range="2", bandwidth=300, seed=1, radio=radio
        )
        team = Team(plan)
        free = np.argwhere(team.truth == FREE)[:, ::-1]
        near, far = free[0], free[-1]
        cells = {at: (int(x), int(y)) for at, (x, y) in enumerate([near, free[1], far, free[-2]])}
        for _ in range(12):
            team.stand(cells)
        rows = team.ledger()
        most_bytes[reuse] = np.bincount(rows["step"], rows["bytes"] * rows["carried"]).max()
    assert most_bytes[False] <= 300
    assert 300 < most_bytes[True] <= 600
