"""Replay protection: a sliding window over the frame numbers of one sender, as in IPsec (RFC 4303, section 3.4.3).

A frame number consists of a session, which counts the starts of the sender, and a counter within the session. Numbers
ascend over all sessions, so a window that remembers the highest number also rejects frames of earlier sessions.
"""

from __future__ import annotations

WINDOW = 64
"""Counters behind the highest one that may still arrive, in any order, each once."""

SESSION_BITS, COUNTER_BITS = 16, 24
MAX_SESSION, MAX_COUNTER = (1 << SESSION_BITS) - 1, (1 << COUNTER_BITS) - 1


def frame_number(session: int, counter: int) -> int:
    """Return session and counter as one number; numbers of later sessions are higher."""
    return session << COUNTER_BITS | counter


class ReplayWindow:
    """The frame numbers of one sender that have been accepted.

    `highest`: the highest number accepted before a restart of the receiver, 0 if there is none. Numbers up to it count
    as accepted: a frame that was still on its way then is lost, and none is accepted twice.
    """

    def __init__(self, highest: int = 0) -> None:
        self.highest = highest
        self._accepted = (1 << WINDOW) - 1
        """Bit i is set if the number ``highest - i`` has been accepted."""

    def accept(self, number: int) -> bool:
        """Accept a number, or return False if it was accepted before, or is too old to tell."""
        if number > self.highest:
            ahead = number - self.highest
            same_session = number >> COUNTER_BITS == self.highest >> COUNTER_BITS
            before = self._accepted << ahead if same_session and ahead < WINDOW else 0
            self._accepted = (before | 1) & ((1 << WINDOW) - 1)
            self.highest = number
            return True
        behind = self.highest - number
        if behind >= WINDOW or number >> COUNTER_BITS < self.highest >> COUNTER_BITS:
            return False
        if self._accepted >> behind & 1:
            return False
        self._accepted |= 1 << behind
        return True
