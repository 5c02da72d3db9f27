"""Events of a run: reports become positions, loads and events."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from deploy.dashboard.help_text import explain
from deploy.dashboard.run_events import RunEvents
from deploy.scenario.plan import make
from deploy.scenario.scenario import parse
from netshaper.ledger import CAUSES, KIND_NUMBER, LINK, ROW
from protocol.messages import Change, End, ErrorReport, Lost, Missed, RadioReport, RobotStatus, WorldReport
from tests.deploy.small_run import SETTINGS, reports, small_plan
from worldsim.maps import to_world


def where(step: int, *cells: tuple[int, int] | None, seen: int = 50) -> WorldReport:
    poses = [(r, 100 * cell[0], 100 * cell[1], 0) for r, cell in enumerate(cells) if cell is not None]
    return WorldReport(step, np.array(poses, "<i4").tobytes(), [0] * len(cells), seen, 100)


def status(step: int, x: int, y: int, status: str = "driving to the target") -> RobotStatus:
    return RobotStatus(step, x, y, known=100, error=0, exact_error=-1, backlog=7, status=status, work_us=0)


def air(step: int, *rows: dict[str, Any], links: Sequence[tuple[int, int, int]] = ()) -> RadioReport:
    table = np.zeros(len(rows), ROW)
    for row, values in zip(table, rows, strict=True):
        row["step"], row["carried"] = step, 1
        for name, value in values.items():
            row[name] = value
    received = np.array(list(links), LINK).tobytes()
    return RadioReport(step, table.tobytes(), int(table["bytes"][table["carried"] == 1].sum()), b"", received)


def texts(events: RunEvents, sender: str, report: object) -> list[str]:
    return [event.text for event in events.take(sender, report)]


@pytest.fixture
def events() -> RunEvents:
    return RunEvents(small_plan())


def test_robots_come_into_range_and_are_lost_from_it(events: RunEvents) -> None:
    assert texts(events, "world", where(1, (10, 10), (20, 10), (200, 200))) == []
    assert events.in_range == {(0, 1)}
    assert texts(events, "world", where(2, (10, 10), (200, 210), (200, 200))) == [
        "robots 0 and 1 are out of range",
        "robots 1 and 2 are in range",
    ]
    assert events.seen == 0.5
    assert events.positions[0] == to_world(small_plan().map, 10, 10)


def test_robots_are_in_range_as_the_radio_model_says() -> None:
    apart = RunEvents(make(parse(SETTINGS | {"range": "60%", "radio": {"model": "line-of-sight"}})))
    apart.take("world", where(1, (10, 10), (20, 10), (200, 10)))
    assert apart.in_range == {(0, 1)}, "walls are between the others"
    assert texts(apart, "relay", Change(2, range_mm=100)) == ["radio changed: range 0.1 m"]
    apart.take("world", where(2, (10, 10), (20, 10), (200, 10)))
    assert not apart.in_range


def test_the_cell_of_a_robot_beside_its_center_is_that_of_the_relay(events: RunEvents) -> None:
    """With a range of eight cells, robots in the cells 10 and 19 are out of range, wherever they are in them."""
    events.take("relay", Change(1, range_mm=800))
    for x, is_near in ((1849, True), (1850, False), (1860, False), (1900, False), (1949, False)):
        poses = np.array([(0, 1000, 1000, 0), (1, x, 1000, 0)], "<i4")
        events.take("world", WorldReport(1, poses.tobytes(), [0, 0], 50, 100))
        assert events.in_range == ({(0, 1)} if is_near else set()), x


def test_missed_steps_are_counted_and_late_answers_of_the_radio_are_named(events: RunEvents) -> None:
    assert texts(events, "relay", Missed(4, "offers", 1, [2])) == [
        "robot 2 answered too late: offers of round 1"
    ]
    assert texts(events, "world", Missed(4, "move", 0, [0, 2])) == ["robots 0, 2 missed the step"]
    assert texts(events, "world", Missed(5, "step", 0, [2])) == [
        "robot 2 took no part: still at work on an earlier step"
    ]
    assert events.missed == {0: 1, 2: 2}


def test_a_target_is_logged_if_it_is_another_frontier(events: RunEvents) -> None:
    events.take("world", where(1, (10, 10)))
    assert texts(events, "r0", status(1, 50, 50)) == ["robot 0 heads for (5.1, 20.0) m"]
    assert texts(events, "r0", status(2, 51, 52)) == []
    assert events.targets[0] == to_world(small_plan().map, 51, 52)
    assert texts(events, "r0", status(3, 90, 52)) == ["robot 0 heads for (9.1, 19.8) m"]
    events.take("r0", status(4, -1, -1))
    assert 0 not in events.targets
    assert events.backlog == {0: 7}


def test_idleness_is_logged_once(events: RunEvents) -> None:
    idle = "idle: no reachable frontier on the planning grid"
    assert texts(events, "r2", status(5, -1, -1, idle)) == ["robot 2 is idle: its map is complete"]
    assert texts(events, "r2", status(6, -1, -1, idle)) == []
    texts(events, "r2", status(7, 10, 10))
    assert len(texts(events, "r2", status(8, -1, -1, idle))) == 1


def test_bytes_are_summed_by_traffic_type_and_link(events: RunEvents) -> None:
    insert, offer, target, new = (KIND_NUMBER[kind] for kind in ("ins", "conn", "targ", "em"))
    waiting = CAUSES.index("budget")
    report = texts(
        events,
        "relay",
        air(
            3,
            {"kind": insert, "bytes": 60, "sender": 2, "receiver": 0, "map": 2},
            {"kind": offer, "bytes": 2, "sender": 0, "receiver": 2},
            {"kind": new, "bytes": 10, "packets": 2, "sender": 2, "receiver": 0, "map": 2},
            {"kind": new, "bytes": 5, "packets": 1, "sender": 2, "receiver": 0, "map": 1},
            {"kind": target, "bytes": 3, "sender": 1, "receiver": -1},
            {"kind": insert, "bytes": 600, "sender": 0, "receiver": 1, "carried": 0, "cause": waiting},
            links=[(0, 2, 2), (1, 0, 3), (2, 0, 75)],
        ),
    )
    assert events.traffic is not None
    assert {group: size for group, size in events.traffic.groups.items() if size} == {
        "vertices": 60,
        "control": 2,
        "objects": 15,
        "targets": 3,
    }
    assert events.traffic.carried == 80
    assert events.traffic.links == {(0, 2): 2, (1, 0): 3, (2, 0): 75}
    assert events.bytes == {"ins": 60, "conn": 2, "em": 15, "targ": 3}
    assert report == ["robot 2 reports 2 new objects", "channel full: 600 B not sent"]
    assert texts(events, "relay", air(4)) == []


def test_losses_protocol_errors_and_the_end_are_logged(events: RunEvents) -> None:
    events.take("world", where(1, (10, 10), (20, 10)))
    events.take("r1", status(1, 50, 50))
    (lost,) = events.take("relay", Lost(1, "its process ended"))
    assert lost.weight == 2
    assert lost.text == "robot 1 is lost: its process ended"
    assert not events.in_range
    assert not events.targets
    assert texts(events, "relay", ErrorReport("r0", "spoke out of turn")) == [
        "r0 sent a malformed message: spoke out of turn"
    ]
    assert texts(events, "relay", End(9, "explored", 0)) == ["explored; robot 0 finished first"]
    assert texts(events, "relay", End(9, "out of steps", -1)) == ["the run ended: out of steps"]


def test_a_breakdown_is_logged_once(events: RunEvents) -> None:
    events.take("world", where(1, (10, 10), (20, 10)))
    assert texts(events, "world", where(2, (10, 10), None)) == ["robot 1 has broken down"]
    assert texts(events, "world", where(3, (10, 10), None)) == []


def test_a_late_viewer_can_start_with_any_report() -> None:
    received = reports()
    for first in range(0, 60, 7):
        events = RunEvents(small_plan())
        for sender, report in received[first:]:
            events.take(sender, report)
        assert events.step == 40
        assert sorted(events.positions) == [0, 1, 2]


def test_the_help_text_describes_this_run() -> None:
    text = explain(small_plan())
    assert "3 robots" in text
    assert "1000 bytes per step" in text
    assert "Sensor range: 5 m" in text
    assert "Pale outlines" in text
    assert "the limit" in text
    text = explain(small_plan(map_encoding="scans", bandwidth="unlimited", range="100%"))
    assert "unlimited bandwidth" in text
    assert "outlines" not in text
    assert "the limit" not in text
    assert "Circles" not in text
    mixed = parse({"robots": 3, "robot": [{"robot": 1, "sensor_range": 6.5}]})
    assert "Sensor range: 5 to 6.5 m" in explain(make(mixed))


def test_a_channel_with_room_is_not_full_because_poses_exceed_their_share(events: RunEvents) -> None:
    pose, update, refused = KIND_NUMBER["pose"], KIND_NUMBER["update"], CAUSES.index("budget")
    limit = 1000
    more = {"kind": pose, "bytes": 4, "sender": 1, "receiver": -1, "carried": 0, "cause": refused}
    assert (
        texts(
            events, "relay", air(3, {"kind": update, "bytes": limit - 4, "sender": 0, "receiver": -1}, more)
        )
        == []
    )
    assert texts(
        events, "relay", air(4, {"kind": update, "bytes": limit - 3, "sender": 0, "receiver": -1}, more)
    ) == ["channel full: 4 B not sent"]
