"""The world by the wall clock: steps end on time, and late robots miss them."""

from __future__ import annotations

from protocol import keys as names
from protocol.messages import ErrorReport, FaultEvent, Missed, Move, Positions, Sense
from tests.worldsim.test_world_process import Run
from worldsim.clock import MOVE, STEP, RecordedClock, WallClock

STEP_NS = 1000


class WallRun(Run):
    """A world by the wall clock, of which the test sets the time."""

    def __init__(self, robots: int = 2) -> None:
        super().__init__(robots, steps=30, clock=WallClock(STEP_NS))
        self.received(names.RECORDER)

    def wait(self, now_ns: int) -> None:
        """Let the time pass without a message."""
        self.node.tick(now_ns)
        self.close()
        self.work()
        self.node.deadline(now_ns)

    def missed(self) -> list[Missed]:
        return [each for each in self.received(names.RECORDER) if isinstance(each, Missed)]


def test_a_step_ends_on_time_even_if_all_robots_have_moved() -> None:
    run = WallRun()
    assert run.node.deadline(50) == 50 + STEP_NS
    run.stay(0, 1)
    assert run.world.step == 1
    run.wait(49 + STEP_NS)
    assert run.world.step == 1
    run.wait(50 + STEP_NS)
    assert run.world.step == 2
    assert run.node.deadline(60 + STEP_NS) == 50 + 2 * STEP_NS
    assert run.missed() == []


def test_steps_do_not_catch_up_after_a_late_one() -> None:
    run = WallRun()
    assert run.node.deadline(0) == STEP_NS
    run.stay(0, 1)
    run.wait(5 * STEP_NS)
    assert run.world.step == 2
    assert run.node.deadline(5 * STEP_NS) == 6 * STEP_NS


def test_a_step_does_not_end_before_the_medium_is_closed() -> None:
    run = WallRun()
    run.closed = 99  # the relay does not close further steps
    run.node.deadline(0)
    run.node.tick(STEP_NS)
    assert run.world.step == 2
    assert run.node.deadline(STEP_NS) is None
    run.node.tick(9 * STEP_NS)
    assert run.world.step == 2


def test_a_late_robot_misses_the_step_and_takes_part_again_after_its_move() -> None:
    run = WallRun()
    run.wait(0)
    for step in (1, 2, 3):
        run.stay(0)
        run.wait(step * STEP_NS)
    assert run.world.step == 4
    assert run.missed() == [Missed(1, MOVE, 0, [1]), Missed(2, MOVE, 0, [1]), *absent(3), *absent(4)]
    for step in (1, 2):
        run.move(1, Move(step, b"", 0, explored=True))
    run.stay(0)
    run.wait(4 * STEP_NS)
    assert run.world.step == 5
    assert run.missed() == []
    assert run.ended() is None
    senses = [message.step for message in run.received("r1") if isinstance(message, Sense)]
    assert senses == [1, 2, 5]


def absent(step: int) -> list[Missed]:
    return [Missed(step, STEP, 0, [1])]


def test_the_relay_receives_no_position_of_an_absent_robot() -> None:
    run = WallRun()
    run.wait(0)
    for step in (1, 2):
        run.stay(0)
        run.wait(step * STEP_NS)
    positions = [message.robots for message in run.received(names.RELAY) if isinstance(message, Positions)]
    assert positions == [[0, 1], [0, 1], [0]]


def test_a_run_waits_for_robots_that_are_all_late() -> None:
    run = WallRun()
    run.wait(0)
    for step in (1, 2, 3, 4):
        run.wait(step * STEP_NS)
    assert run.world.step == 5
    assert run.ended() is None
    assert list(run.world.cells) == [0, 1]


def test_a_run_is_not_stalled_while_a_robot_is_late() -> None:
    run = WallRun()
    run.wait(0)
    run.stay(0, stalled=True)
    run.wait(STEP_NS)
    assert run.ended() is None


def test_a_recorded_clock_drops_the_moves_that_were_late() -> None:
    record = [Missed(1, MOVE, 0, [1]), Missed(2, STEP, 0, [1])]
    run = Run(steps=30, clock=RecordedClock(record))
    run.stay(1, explored=True)
    assert run.world.step == 1
    run.stay(0)
    assert run.world.step == 2
    assert run.ended() is None
    run.stay(0)
    assert run.world.step == 3
    assert [message.step for message in run.received("r1") if isinstance(message, Sense)] == [1, 3]
    run.stay(0)
    assert run.world.step == 3


def test_the_late_move_of_a_robot_that_a_fault_has_removed_is_no_error() -> None:
    run = WallRun(3)
    run.wait(0)
    run.stay(0, 2)
    run.wait(STEP_NS)
    run.control(FaultEvent(3, 1, "kill"))
    run.stay(0, 2)
    run.wait(2 * STEP_NS)
    assert run.world.step == 3
    for step in (1, 2):
        run.move(1, Move(step, b"", 0, explored=False))
    assert not [each for each in run.received(names.RECORDER) if isinstance(each, ErrorReport)]
