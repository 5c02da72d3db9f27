"""A broadcast as it is put together."""

from agent.exchange.broadcast import Broadcast
from agent.exchange.log import Log
from protocol.packets import Held, Near


def _log() -> Log:
    log = Log()
    log.append([b"abc", b"de", b"fghi"])
    return log


def test_a_report_that_finds_no_room_is_left_out_and_a_shorter_one_still_goes_in() -> None:
    said = Broadcast(4)
    assert said.report(Held(1, 300)) is None
    assert said.report(Near(1)) == 2
    assert said.report(Near(2)) == 4
    assert said.report(Near(3)) is None
    assert len(said.payload) == 4


def test_a_stretch_ends_with_the_last_unit_that_finds_room_behind_its_head() -> None:
    said = Broadcast(7)
    assert said.stretch(5, _log(), 0, 3, b"--") == 2
    assert said.payload == b"--abcde"
    assert (said.stretches[0].begin, said.stretches[0].end) == (2, 7)
    assert said.spoken == {5: (0, 2)}


def test_a_head_does_not_stand_alone() -> None:
    said = Broadcast(4)
    assert said.stretch(5, _log(), 0, 3, b"--") == 0
    assert said.stretch(5, _log(), 2, 2, b"--") == 2
    assert said.payload == b""
    assert said.stretches == []


def test_without_a_limit_all_goes_in_and_stretches_of_a_map_grow_together() -> None:
    said = Broadcast()
    assert said.stretch(0, _log(), 1, 3, b"") == 3
    assert said.stretch(0, _log(), 0, 1, b"-") == 1
    assert said.payload == b"defghi-abc"
    assert said.spoken == {0: (0, 3)}
