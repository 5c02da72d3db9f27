"""The time limit for robots' replies, with a clock that stops while the waiting process is stopped."""

from __future__ import annotations

import time

import pytest

from deploy.run.reply_timeout import ReplyTimeout


class WaitingNode:
    """A relay that waits for robot 0."""

    phase = 0

    def __init__(self) -> None:
        self.lost: list[int] = []

    def waiting_for(self) -> list[int]:
        return [0]

    def give_up_on(self, robot: int, cause: str) -> None:
        self.lost.append(robot)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time that the limit reads; tests set it."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_robot_that_does_not_reply_is_lost(clock: list[float]) -> None:
    node = WaitingNode()
    limit = ReplyTimeout(node, 2.0)
    for _ in range(9):
        clock[0] += 0.25
        assert not node.lost
        limit.check()
    assert node.lost == [0]


def test_time_during_which_the_waiting_process_was_stopped_does_not_count(clock: list[float]) -> None:
    node = WaitingNode()
    limit = ReplyTimeout(node, 2.0)
    clock[0] += 600.0
    assert limit.check() < 2.0
    clock[0] += 0.25
    limit.check()
    assert not node.lost
