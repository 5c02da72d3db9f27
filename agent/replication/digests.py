"""Digests of logs: a robot finds out whether the entries that it holds are those that their author wrote.

Every `INTERVAL` steps per robot of the team, a robot broadcasts the hash of its log so far (`packets.LogDigest`). A
receiver hashes as many entries of its copy. Equal hashes verify these entries. Otherwise a forwarder forged some of
them, or a frame was damaged (`agent.replication.replica` has the reaction). A digest also contains whether the author
has sent further entries. If not, a receiver's further entries are forged.

The salt, which the author draws from its sensor readings, is hashed behind the entries. A forger cannot know it in
advance, so a forgery of the same length passes with a probability of 2**-16. A digest counts only if it comes from the
log's author; the medium vouches for senders.
"""

from __future__ import annotations

from hashlib import blake2b

from agent.replication.control_packets import nearest
from agent.replication.log import Log
from protocol.packets import DIGEST_WINDOW, LogDigest

INTERVAL = 8
"""Steps between two digests of a robot, divided by the size of the team."""

MAX_OPEN = 8
"""Digests of a log kept until as many entries have arrived."""


class LogVerifier:
    """The verified prefix of one log, and digests of entries that have not arrived yet.

    `ordered`: no digest arrives after entries that its author sent later.
    """

    def __init__(self, log: Log, *, ordered: bool = True) -> None:
        self.length = 0
        """Number of verified entries."""
        self._log = log
        self._ordered = ordered
        self._hash = blake2b(digest_size=2)
        """Hash of the verified entries."""
        self._open: list[tuple[int, bool, LogDigest]] = []
        """Length, whether this log was longer when the digest of a complete one arrived, and the digest."""
        self.complete_length = -1
        """Number of entries if the last digest that was checked verified all that the author had sent, else -1."""
        self._end = (-1, 0)
        """Length and salt of the last digest of a complete log that was shorter than this one; -1 if there is none."""

    def digest(self, length: int, salt: int, *, complete: bool) -> LogDigest:
        """Return the digest of the first `length` entries, no fewer than are verified.

        `salt` is below 2**7; `complete`: whether the author has sent no further entries.
        """
        digest = self._hash.copy()
        digest.update(self._log.read(self.length, None, length) + bytes([salt]))
        return LogDigest(length % DIGEST_WINDOW, complete, salt, int.from_bytes(digest.digest(), "big"))

    def receive(self, digest: LogDigest) -> None:
        """Keep a digest of the author until it can be checked."""
        length = nearest(digest.entries, len(self._log), DIGEST_WINDOW)
        if length >= self.length:
            longer = bool(digest.complete) and length < len(self._log)
            self._open = sorted([*self._open, (length, longer, digest)], key=lambda each: each[0])[:MAX_OPEN]

    def check(self) -> bool | None:
        """Check the digests of entries that have arrived: True if more entries are verified now, None if none are.

        False: an entry behind the verified ones is not the author's.
        """
        verified = self.length
        while self._open and self._open[0][0] <= len(self._log):
            length, longer, digest = self._open.pop(0)
            if length < self.length:
                continue
            if self.digest(length, digest.salt, complete=bool(digest.complete)) != digest:
                self.complete_length = -1
                return False
            self._hash.update(self._log.read(self.length, None, length))
            self.length = length
            self.complete_length = length if digest.complete else -1
            if longer:  # entries behind the end are forged; if digests may be late, a second one must agree
                (before, salt), self._end = self._end, (length, digest.salt)
                if self._ordered or (before == length and salt != digest.salt):
                    return False
        return True if self.length > verified else None
