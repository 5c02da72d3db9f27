"""Reports of a step are processed together, in whatever order the bus delivers those of different senders."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.dashboard.step_order import StepOrder, StepReports
from protocol.messages import (
    Change,
    End,
    ErrorReport,
    Lost,
    Missed,
    RadioReport,
    RobotStatus,
    Shutdown,
    WorldReport,
)
from tests.deploy.small_run import reports


def world(step: int, *robots: int) -> tuple[str, object]:
    poses = np.array([(robot, 0, 0, 0) for robot in robots], "<i4")
    return "world", WorldReport(step, poses.tobytes(), [0] * len(robots), 1, 2)


def radio(step: int) -> tuple[str, object]:
    return "relay", RadioReport(step, b"", 0, b"")


def status(step: int, robot: int) -> tuple[str, object]:
    return f"r{robot}", RobotStatus(step, -1, -1, 0, 0, -1, 0, "", 0)


def steps(done: list[StepReports]) -> list[int]:
    return [each.step for each in done]


def test_a_step_is_complete_with_the_reports_of_world_radio_and_all_robots() -> None:
    order = StepOrder()
    for sender, report in (status(1, 1), radio(1), world(1, 0, 1)):
        assert order.put(sender, report) == []
    (done,) = order.put(*status(1, 0))
    assert (done.step, done.has_world) == (1, True)
    assert [type(report) for _, report in done.reports] == [
        WorldReport,
        RadioReport,
        RobotStatus,
        RobotStatus,
    ]


def test_a_radio_report_that_arrives_after_the_next_step_of_the_world_belongs_to_its_own_step() -> None:
    order = StepOrder()
    for sender, report in (world(1, 0), status(1, 0), world(2, 0)):
        assert order.put(sender, report) == []
    (done,) = order.put(*radio(1))
    assert {report.step for _, report in done.reports} == {1}  # type: ignore[attr-defined]
    assert order.put(*status(2, 0)) == []
    assert steps(order.put(*radio(2))) == [2]


def test_a_change_of_the_radio_applies_before_the_positions_of_its_step() -> None:
    order = StepOrder()
    for sender, report in (world(1, 0), ("relay", Change(1, range_mm=5)), status(1, 0)):
        order.put(sender, report)
    (done,) = order.put(*radio(1))
    assert [type(report) for _, report in done.reports[:2]] == [Change, WorldReport]


def test_no_step_waits_for_lost_or_late_robots() -> None:
    order = StepOrder()
    for sender, report in (world(1, 0, 1, 2), radio(1), status(1, 0)):
        assert order.put(sender, report) == []
    assert order.put("relay", Lost(1, "its process ended")) == []
    assert steps(order.put("world", Missed(1, "move", 0, [2]))) == [1]
    for sender, report in (world(2, 0, 1, 2), radio(2)):
        assert order.put(sender, report) == []
    assert order.put(*world(3, 0, 1, 2)) == []
    assert steps(order.put(*world(4, 0, 1, 2))) == [2], "overdue"
    (late,) = order.put(*status(2, 1))
    assert (late.step, late.has_world, len(late.reports)) == (2, False, 1)


def test_the_end_waits_for_its_step_and_a_shutdown_ends_all() -> None:
    order = StepOrder()
    for sender, report in (world(1, 0), radio(1), ("relay", End(1, "explored", 0))):
        assert order.put(sender, report) == []
    (done,) = order.put(*status(1, 0))
    assert type(done.reports[-1][1]) in (End, RobotStatus)
    order.put(*world(2, 0))
    assert steps(order.put("relay", Shutdown())) == [2]
    assert order.finish() == []


def test_a_robot_can_neither_skip_ahead_nor_repeat_its_status() -> None:
    order = StepOrder()
    for number in range(1, 50):
        assert order.put(*status(10**9 + number, 0)) == []
        assert len(order.put("view", ErrorReport("r0", f"error {number}"))) == 1
    for sender, report in (world(1, 0), world(2, 0)):
        order.put(sender, report)
    (done,) = order.put(*world(3, 0))
    assert done.step == 1
    assert len(done.reports) == 2


ON_TIME = WorldReport | RadioReport | RobotStatus


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_any_interleaving_of_senders_gives_the_same_steps(seed: int) -> None:
    """The order of each sender's reports is kept, but one sender may lag behind the others."""
    rng = np.random.default_rng(seed)
    queues: dict[str, list[tuple[int, object]]] = {}
    for number, (sender, report) in enumerate(reports()):
        if isinstance(report, ON_TIME):
            queues.setdefault(sender, []).append((number, report))
    delayed = sorted(
        (number + float(rng.integers(0, 5)), sender, place)
        for sender, queue in queues.items()
        for place, (number, _) in enumerate(queue)
    )
    places = dict.fromkeys(queues, 0)
    shuffled: list[tuple[str, object]] = []
    for _, sender, _ in delayed:
        shuffled.append((sender, queues[sender][places[sender]][1]))
        places[sender] += 1
    in_order = [(sender, report) for sender, report in reports() if isinstance(report, ON_TIME)]
    assert [sender for sender, _ in shuffled] != [sender for sender, _ in in_order]
    assert by_step(in_order) == by_step(shuffled)


def by_step(received: list[tuple[str, object]]) -> list[tuple[int, set[tuple[str, str, int]]]]:
    order = StepOrder()
    done = [step for sender, report in received for step in order.put(sender, report)] + order.finish()
    return [
        (
            each.step,
            {(sender, type(report).__name__, getattr(report, "step", 0)) for sender, report in each.reports},
        )
        for each in done
        if each.has_world
    ]
