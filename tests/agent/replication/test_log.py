"""Logs, frames, and the tables of neighbors: the parts that know nothing of each other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from agent.replication.control_packets import parse
from agent.replication.digests import MAX_OPEN, LogVerifier
from agent.replication.log import Log
from agent.replication.neighbors import GREETING, BroadcastCursors, Links, Meetings
from agent.replication.peers import PeerTable
from agent.replication.replica import ASK_AGAIN, LONGEST, MANY, TRIES, Replica
from protocol import packet_index
from protocol.errors import ProtocolError
from protocol.packet_codec import encode
from protocol.packets import DIGEST_WINDOW, FromFirst, Near
from tests.agent.replication.network import entries, entry

sizes = st.lists(st.integers(1, 30), max_size=12)


def log_of(*lengths: int) -> tuple[Log, list[bytes]]:
    log, units = Log(), [bytes([number]) * size for number, size in enumerate(lengths)]
    log.append(units)
    return log, units


@given(sizes, st.data())
def test_a_log_returns_the_entries_that_fit_from_an_offset(lengths: list[int], data: st.DataObject) -> None:
    log, units = log_of(*lengths)
    first = data.draw(st.integers(0, len(units)))
    budget = data.draw(st.none() | st.integers(0, 200))
    got = log.read(first, budget)
    after = log.offset_after(first, len(got))
    assert len(log) == len(units)
    assert got == b"".join(units[first:after])
    if budget is None:
        assert after == len(units)
    else:
        assert len(got) <= budget
        assert after == len(units) or len(got) + lengths[after] > budget
    end = data.draw(st.integers(first, len(units)))
    assert log.read(first, budget, end) == b"".join(units[first : min(end, after)])


@given(sizes, st.data())
def test_a_log_continues_where_it_was_cut(lengths: list[int], data: st.DataObject) -> None:
    log, units = log_of(*lengths)
    left = data.draw(st.integers(0, len(units)))
    log.cut(left)
    log.append(units)
    assert log.read(0) == b"".join(units[:left] + units)
    assert len(log) == left + len(units)


@pytest.mark.parametrize(
    ("budget", "first", "end", "payload", "after"),
    [(7, 0, 3, b"--abcde", 2), (4, 0, 3, b"", 0), (9, 2, 2, b"", 2), (None, 1, 3, b"--defghi", 3)],
)
def test_entries_go_in_as_far_as_they_fit_and_no_header_stands_alone(
    budget: int | None, first: int, end: int, payload: bytes, after: int
) -> None:
    log = Log()
    log.append([b"abc", b"de", b"fghi"])
    assert log.read(first, budget, end, b"--") == payload
    assert log.offset_after(first, max(0, len(payload) - 2)) == after


def test_a_frame_is_split_into_control_packets_and_entries_behind_their_headers() -> None:
    own, others = entries(0, 0, 2), entries(1, 5, 8)
    controls, sections, named = parse(
        encode([Near(1)]) + b"".join(own) + encode([FromFirst(2, 9), FromFirst(1, 5)]) + b"".join(others)
    )
    assert controls == [Near(1), FromFirst(2, 9), FromFirst(1, 5)]
    assert sections == [(None, own), (FromFirst(1, 5), others)]
    assert named == [FromFirst(2, 9)]
    with pytest.raises(ProtocolError):
        parse(b"\xff")


def test_all_robots_are_neighbors_until_they_report_otherwise() -> None:
    neighbors = Links(0, 4)
    neighbors.begin_step([1, 2, 3])
    assert neighbors.news == []
    assert not neighbors.have_parted
    assert np.flatnonzero(neighbors.near[2]).tolist() == [0, 1, 2, 3], "each robot is in its own range"
    neighbors.near[2, 3] = False
    assert np.flatnonzero(neighbors.near[2]).tolist() == [0, 1, 2]
    assert neighbors.near[3, 2]
    assert not neighbors.near[2, 3]


def test_a_departure_is_news_until_all_in_range_received_it() -> None:
    neighbors = Links(0, 4)
    neighbors.begin_step([1])
    assert neighbors.news == [(2, False), (3, False)]
    neighbors.inform(3, here=False)
    assert neighbors.news == [(2, False)]
    neighbors.begin_step([1, 2])
    assert neighbors.news == [(3, False)]
    neighbors.inform(3, here=False)
    assert neighbors.news == []
    neighbors.begin_step([1, 2, 3])
    assert neighbors.news == [(3, True)]


def test_a_robot_that_restarts_has_received_and_sent_nothing() -> None:
    neighbors = Links(0, 3)
    neighbors.near[1, 2] = False
    neighbors.begin_step([1])
    neighbors.inform(2, here=False)
    assert neighbors.news == []
    neighbors.restarted(1)
    assert neighbors.near[1, 2]
    assert neighbors.news == [(2, False)]


def test_robots_that_meet_owe_reports_and_await_one() -> None:
    meetings = Meetings(4, settled=True)
    meetings.begin_step(1, [1, 2])
    assert (meetings.owed, meetings.known([1, 2])) == (set(), [1, 2]), "all logs are empty at first"
    meetings.begin_step(2, [1, 3])
    assert (meetings.owed, meetings.known([1, 3])) == ({3}, [1])
    meetings.on("reported", 3)
    assert (meetings.owed, meetings.known([1, 3])) == ({3}, [1, 3])
    meetings.on("informed", 3)
    meetings.on("restarted", 1)
    assert (meetings.owed, meetings.known([1, 3])) == ({1}, [1, 3])
    for step in range(3, 4 + GREETING):
        meetings.begin_step(step, [2])
        assert (meetings.owed, meetings.known([2])) == ({2}, [])
    meetings.begin_step(4 + GREETING, [2])
    assert (meetings.owed, meetings.known([2])) == ({2}, [2]), "a silent peer is not waited for"
    meetings.begin_step(5 + GREETING, [])
    assert meetings.owed == set()


def test_cursors_are_known_to_robots_that_were_in_range_ever_since() -> None:
    cursors = BroadcastCursors(3, known=True, reliable=True)
    assert cursors.known(0, [1, 2])
    assert cursors.others[1] == 0
    cursors.begin_step([1])
    cursors.sent(5, [1])
    cursors.received(1, 3)
    assert cursors.known(5, [1])
    assert not cursors.known(5, [1, 2])
    assert cursors.others == {1: 3}
    unreliable = BroadcastCursors(3, known=True, reliable=False)
    unreliable.sent(5, [1])
    assert not unreliable.known(5, [1])


class _Judge:
    """A replica of four robots that decodes all entries but `malformed` ones."""

    malformed = b"lie"

    def __init__(self) -> None:
        self.replica = Replica(PeerTable(0, 4, 4), self._consume, lambda _logs: None)

    def _consume(self, peer: int, map_id: int, frame: bytes) -> list[int]:
        if frame == self.malformed:
            raise ProtocolError("entry", 0, "a lie")
        return [len(frame)]

    def steps_refused(self, peer: int, number: int) -> int:
        """Steps from this one on in which a peer's entries of a map are not accepted."""
        replica, first = self.replica, self.replica.step
        while replica.refuses(peer, number):
            replica.step += 1
        steps, replica.step = replica.step - first, first
        return steps


def test_a_malformed_entry_is_rejected_and_its_sender_suspected_for_that_map_alone() -> None:
    judge = _Judge()
    replica = judge.replica
    assert replica.accept(1, 2, entry(2, 0))
    assert not replica.accept(3, 2, b"lie")
    assert replica.take_rejected() == [(3, "entry at byte 0: a lie")]
    assert replica.distrusted == set(), "robot 1 may have sent the wrong entry"
    assert [replica.refuses(3, number) for number in (2, 3)] == [True, False]
    assert replica.accept(3, 3, entry(3, 0))
    assert not replica.accept(3, 2, entry(2, 1)), "of this map nothing is accepted from robot 3"
    assert replica.take_rejected() == [], "what a suspected robot sends is dropped unread"
    assert replica.accept(1, 2, entry(2, 1))


def test_a_suspicion_lasts_twice_as_long_each_time_and_many_are_distrust() -> None:
    judge = _Judge()
    replica, lasted = judge.replica, []
    for _ in range(MANY + 2):
        assert replica.distrusted == ({3} if len(lasted) >= MANY else set())
        assert not replica.accept(3, 2, b"lie")
        lasted.append(judge.steps_refused(3, 2))
        replica.step += lasted[-1]
    assert lasted == [min(4 << count, LONGEST) for count in range(MANY + 2)]
    assert replica.accept(3, 2, entry(2, 0)), "what it sends later is accepted all the same"


def test_an_author_may_repeat_at_once_an_entry_that_was_damaged() -> None:
    judge = _Judge()
    replica = judge.replica
    assert not replica.accept(2, 2, b"lie")
    assert not replica.refuses(2, 2)
    assert not replica.accept(2, 2, b"lie")
    assert judge.steps_refused(2, 2) == 2


def test_a_digest_that_matches_clears_its_forwarders_and_one_that_does_not_drops_their_entries() -> None:
    judge = _Judge()
    replica, author = judge.replica, LogVerifier(log := Log())
    log.append(entries(2, 0, 4))
    assert not replica.accept(3, 2, b"lie")
    replica.step += 4
    assert replica.accept(3, 2, entry(2, 0))
    replica.receive_digest(2, author.digest(1, 5, complete=False))
    assert replica.verifiers[2].length == 1
    assert not replica.accept(3, 2, b"lie")
    assert judge.steps_refused(3, 2) == 4, "robot 3 was trusted again"
    assert replica.accept(1, 2, entry(9, 9))
    assert replica.accept(2, 2, entry(2, 2))
    replica.take_rejected()
    replica.receive_digest(1, author.digest(2, 6, complete=False))
    assert replica.dropped == set(), "robot 1 can vouch for its own log alone"
    replica.receive_digest(2, author.digest(2, 6, complete=False))
    assert replica.dropped == {2}
    assert packet_index.split(replica.logs[2].read(0)) == entries(2, 0, 1)
    assert [each.peer for each in replica.take_rejected()] == [1], "the author is not suspected"
    assert replica.maps_to_ask_for() == []
    replica.step += 1
    assert replica.maps_to_ask_for() == [2]
    replica.asked(2)
    assert replica.maps_to_ask_for() == []
    replica.step += ASK_AGAIN
    assert replica.maps_to_ask_for() == [2]
    assert replica.accept(2, 2, entry(2, 1))
    assert replica.accept(2, 2, entry(2, 2))
    assert replica.accept(2, 2, entry(2, 3))
    assert replica.maps_to_ask_for() == []


def test_entries_behind_wrong_ones_that_fail_again_and_again_take_those_with_them() -> None:
    judge = _Judge()
    replica = judge.replica
    assert replica.accept(1, 2, entry(9, 9))
    for attempt in range(TRIES + 1):
        assert len(replica.logs[2]) == 1, attempt
        assert not replica.accept(2, 2, b"lie")
        replica.step += judge.steps_refused(2, 2)
    assert len(replica.logs[2]) == 0
    assert replica.accept(2, 2, entry(2, 0))


@given(st.lists(st.binary(min_size=1, max_size=4), min_size=1, max_size=9), st.integers(0, 127))
def test_a_digest_verifies_entries_whether_it_arrives_before_or_after_them(
    units: list[bytes], salt: int
) -> None:
    written, before, after = Log(), Log(), Log()
    written.append(units)
    after.append(units)
    digest = LogVerifier(written).digest(len(units), salt, complete=True)
    early, late = LogVerifier(before), LogVerifier(after)
    early.receive(digest)
    for number, unit in enumerate(units):
        assert early.check() is None
        assert early.length == 0, number
        before.append([unit])
    late.receive(digest)
    assert (early.check(), late.check()) == (True, True)
    assert early.length == late.length == len(units)


@given(st.integers(1, 6), st.integers(0, 5), st.integers(0, 127), st.data())
def test_a_digest_of_other_entries_another_salt_or_another_hash_does_not_verify(
    count: int, changed: int, salt: int, data: st.DataObject
) -> None:
    changed %= count
    units, written, held = entries(1, 0, count), Log(), Log()
    written.append(units)
    held.append([*units[:changed], entry(2, changed), *units[changed + 1 :]])
    verifier, author = LogVerifier(held), LogVerifier(written)
    digest = author.digest(count, salt, complete=True)
    if changed:
        verifier.receive(author.digest(changed, salt, complete=False))
        assert verifier.check() is True
    verifier.receive(digest)
    assert verifier.check() is False
    assert verifier.length == changed, "the entries before the changed one stay verified"
    wrong = data.draw(
        st.sampled_from([replace(digest, hash=digest.hash ^ 1), replace(digest, salt=digest.salt ^ 1)])
    )
    verifier = LogVerifier(written)
    verifier.receive(wrong)
    assert verifier.check() is False


def test_digests_are_checked_in_the_order_of_their_lengths_and_many_are_not_kept() -> None:
    written, held = Log(), Log()
    written.append(entries(1, 0, 2 * MAX_OPEN))
    verifier = LogVerifier(held)
    for length in range(2 * MAX_OPEN, 0, -1):
        verifier.receive(LogVerifier(written).digest(length, length, complete=False))
    held.append(entries(1, 0, 2 * MAX_OPEN))
    assert verifier.check() is True
    assert verifier.length == MAX_OPEN
    verifier.receive(LogVerifier(written).digest(3, 3, complete=False))
    assert verifier.check() is None, "a digest of verified entries is ignored"


@pytest.mark.parametrize("ordered", [True, False])
def test_a_digest_of_a_complete_log_exposes_entries_behind_its_end(*, ordered: bool) -> None:
    written, held = Log(), Log()
    written.append(entries(1, 0, 3))
    held.append(entries(1, 0, 4))
    verifier, author = LogVerifier(held, ordered=ordered), LogVerifier(written)
    verifier.receive(author.digest(3, 1, complete=False))
    assert verifier.check() is True
    verifier.receive(author.digest(3, 2, complete=True))
    assert verifier.check() is (False if ordered else None), "late digests must say it twice"
    if not ordered:
        verifier.receive(author.digest(3, 2, complete=True))
        assert verifier.check() is None, "the same digest, delivered twice"
        verifier.receive(author.digest(3, 3, complete=True))
        assert verifier.check() is False


@pytest.mark.parametrize("held", [0, 5, DIGEST_WINDOW // 2 + 10, DIGEST_WINDOW - 3, DIGEST_WINDOW + 20])
def test_lengths_modulo_the_window_mean_the_value_nearest_to_the_receiver_s_log(held: int) -> None:
    length = DIGEST_WINDOW + 20
    units = [bytes([number % 251]) for number in range(length)]
    written, copy = Log(), Log()
    written.append(units)
    copy.append(units[:held])
    digest = LogVerifier(written).digest(length, 9, complete=True)
    assert digest.entries == 20
    verifier = LogVerifier(copy)
    verifier.receive(digest)
    if held > DIGEST_WINDOW // 2 + 20:
        assert verifier.check() is (True if held == length else None)
        copy.append(units[held:])
        assert held == length or verifier.check() is True
        assert verifier.length == length
