"""Sealed frames: encrypted and authenticated by the team's key, and numbered against replays.

A sealed frame is

    sender    u8
    session   u16   how often the sender has started with this key, from 1
    counter   u24   frames of this session before this one
    payload         encrypted
    tag       8 bytes

all numbers big-endian. The cipher is AES-256 in CCM mode with a tag of 8 bytes (NIST SP 800-38C, RFC 6655), as on other
radios with short frames. The header is part of the nonce, and so is authenticated with the payload. A `context` is
authenticated too, but not sent: frames of a team with other settings do not open.

A frame that opens was sent by a holder of the key, is unchanged, and has not opened at this receiver before. It does
not prove *which* holder sent it, nor when: a frame that this robot did not receive may be delivered later, or
elsewhere, by an attacker who recorded it. A forged frame opens with a probability of 2**-64.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Mapping
from typing import Literal, NamedTuple

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESCCM

from agent.radios.replay_window import COUNTER_BITS, MAX_COUNTER, MAX_SESSION, ReplayWindow, frame_number

KEY_BYTES = 32
TAG_BYTES = 8
_HEADER = struct.Struct(">BHBH")
OVERHEAD = _HEADER.size + TAG_BYTES
"""Bytes of a sealed frame besides its payload."""

_NONCE = b"murmur1"
"""First bytes of each nonce, which the header completes to 13 bytes; the digit is the version of the format."""

Reason = Literal[
    "truncated", "unknown sender", "own number", "not authentic", "replayed", "malformed", "too many"
]
"""Reasons for which a frame is dropped.

``truncated``: shorter than any sealed frame. ``unknown sender``: no such robot in the team. ``own number``: the frame
claims to come from this robot; it is an echo, or two robots have the same number. ``not authentic``: it was sealed with
another key or context, or is damaged. ``replayed``: it was received before, or is older than the window. ``malformed``:
it is authentic, but its payload is no frame (`agent.radios.peer_medium`). ``too many``: more frames than a robot takes
in a step.
"""


class SessionExhaustedError(ValueError):
    """A session has used all its counters."""


class Opened(NamedTuple):
    """An authentic frame."""

    sender: int
    session: int
    counter: int
    payload: bytes


class Sealer:
    """Seals the frames of one sender in one session.

    No other sealer may ever have the same key, sender, and session: equal nonces would disclose payloads
    (`agent.radios.session_file`). ValueError: the key has not `KEY_BYTES`, or the session is outside 1 to
    `MAX_SESSION`.
    """

    def __init__(self, key: bytes, sender: int, session: int, context: bytes = b"") -> None:
        if not 1 <= session <= MAX_SESSION:
            raise ValueError(f"session {session} is outside 1 to {MAX_SESSION}: create a new team key")
        self._cipher = _cipher(key)
        self._sender = sender
        self.session = session
        self.counter = 0
        """The number of the next frame."""
        self._context = context

    def seal(self, payload: bytes) -> bytes:
        """Return the next sealed frame; SessionExhaustedError after `MAX_COUNTER` frames."""
        if self.counter > MAX_COUNTER:
            raise SessionExhaustedError(f"this robot has sent {self.counter} frames: start it again")
        header = _HEADER.pack(self._sender, self.session, self.counter >> 16, self.counter & 0xFFFF)
        self.counter += 1
        return header + self._cipher.encrypt(_NONCE + header, payload, self._context)


class Opener:
    """Opens the frames of all teammates of one `robot`, in a team of `robots`.

    `highest` has for each teammate the highest frame number that was accepted before this robot restarted; `key` and
    `context` are as in `Sealer`.
    """

    def __init__(
        self,
        key: bytes,
        robot: int,
        robots: int,
        highest: Mapping[int, int] | None = None,
        context: bytes = b"",
    ) -> None:
        before = highest or {}
        self._cipher = _cipher(key)
        self._robot = robot
        self._context = context
        self._windows = [ReplayWindow(before.get(peer, 0)) for peer in range(robots)]
        self.dropped: Counter[Reason] = Counter()
        """Frames that were dropped, by reason."""

    def open(self, frame: bytes) -> Opened | None:
        """Return an authentic frame that has not been received before; count and drop any other."""
        if len(frame) < OVERHEAD:
            self.dropped["truncated"] += 1
            return None
        header, content = frame[: _HEADER.size], frame[_HEADER.size :]
        sender, session, high, low = _HEADER.unpack(header)
        counter = high << 16 | low
        if sender >= len(self._windows):
            self.dropped["unknown sender"] += 1
            return None
        if sender == self._robot:
            self.dropped["own number"] += 1
            return None
        try:
            payload = self._cipher.decrypt(_NONCE + header, content, self._context)
        except (InvalidTag, ValueError):
            self.dropped["not authentic"] += 1
            return None
        if not session or not self._windows[sender].accept(frame_number(session, counter)):
            self.dropped["replayed"] += 1
            return None
        return Opened(sender, session, counter, payload)

    def highest(self, sender: int) -> int:
        """Return the highest frame number that was accepted from a sender; 0 if there is none."""
        return self._windows[sender].highest


def _cipher(key: bytes) -> AESCCM:
    if len(key) != KEY_BYTES:
        raise ValueError(f"a team key has {KEY_BYTES} bytes, not {len(key)}")
    return AESCCM(key, tag_length=TAG_BYTES)


assert _HEADER.size == 1 + 2 + COUNTER_BITS // 8
