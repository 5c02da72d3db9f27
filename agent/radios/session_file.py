"""The session file of a robot: the sessions and frame numbers that must survive a restart.

A robot writes the number of its session before it sends the first frame of it, so no frame number is used twice. It
writes the highest frame number of each teammate when it accepts a frame, so no frame is accepted again after a restart.

The file has the fingerprint of the key, 8 bytes, and for each robot of the team the highest frame number, as a
big-endian u64; this robot's own slot holds its session. Each key has a file of its own, with the fingerprint in its
name: with a new key all numbers begin anew, and a robot that returns to an earlier key continues its numbers. A file
that is neither empty nor of this form is refused: if it was damaged, numbers could repeat under the same key.

A number that was written survives the end of the process at any moment. It survives a loss of power only after `sync`.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import struct
from pathlib import Path

from agent.radios.replay_window import COUNTER_BITS, MAX_COUNTER, MAX_SESSION, frame_number

_SLOT = struct.Struct(">Q")
_FINGERPRINT = 8


class SessionFileError(ValueError):
    """A session file is in use, malformed, or of another team; the message says what to do."""


class SessionFile:
    """The session file of one robot and key, locked while it is open.

    Its name is that of `path` with the fingerprint of the key before the suffix, as ``r1-0123456789abcdef.session``.
    SessionFileError: another process has the file open, it is damaged or belongs to another team, or the robot has used
    up its sessions.
    """

    def __init__(self, path: Path, key: bytes, robot: int, robots: int) -> None:
        fingerprint = hashlib.sha256(b"murmur session file" + key).digest()[:_FINGERPRINT]
        self.path = path.with_name(f"{path.stem}-{fingerprint.hex()}{path.suffix}")
        self._robot = robot
        self._size = _FINGERPRINT + robots * _SLOT.size
        self._synced = True
        """Whether the disk has all numbers."""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        except OSError as error:
            advice = "set radio.sessions to a directory that keeps its files and that this user may write"
            raise SessionFileError(f"{self.path}: {error.strerror}; {advice}") from None
        try:
            self._begin(fingerprint)
        except Exception:
            os.close(self._file)
            raise

    def _begin(self, fingerprint: bytes) -> None:
        """Lock the file, read it, and write the number of a new session."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise SessionFileError(f"{self.path} is in use: another process runs as this robot") from None
        numbers = self._read(fingerprint)
        self.session = (numbers[self._robot] >> COUNTER_BITS) + 1
        """The number of this session, from 1; no earlier session with this key had it."""
        if self.session > MAX_SESSION:
            raise SessionFileError(f"{self.path}: {MAX_SESSION} sessions are used up: create a new team key")
        numbers[self._robot] = frame_number(self.session, 0)
        self.highest = {robot: number for robot, number in enumerate(numbers) if robot != self._robot}
        """The highest frame number accepted from each teammate before this session; 0 for none."""
        os.pwrite(self._file, fingerprint + b"".join(map(_SLOT.pack, numbers)), 0)
        os.ftruncate(self._file, self._size)
        os.fsync(self._file)
        folder = os.open(self.path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _read(self, fingerprint: bytes) -> list[int]:
        """Return the number in each robot's slot, all 0 if the file is new; SessionFileError if it does not fit."""
        length = os.fstat(self._file).st_size
        data = (
            os.pread(self._file, self._size, 0) if length else fingerprint + bytes(self._size - _FINGERPRINT)
        )
        if data[:_FINGERPRINT] != fingerprint or length % _SLOT.size:
            raise SessionFileError(f"{self.path} is no session file, or damaged: create a new team key")
        if length not in (0, self._size):
            reason = f"{length} bytes instead of {self._size}, so it belongs to a team of another size"
            raise SessionFileError(f"{self.path} has {reason}: create a new team key")
        numbers = [number for (number,) in _SLOT.iter_unpack(data[_FINGERPRINT:])]
        if max(numbers) > frame_number(MAX_SESSION, MAX_COUNTER):
            raise SessionFileError(f"{self.path} is damaged: no frame has the number {max(numbers)}")
        return numbers

    def note(self, sender: int, number: int) -> None:
        """Write the highest frame number accepted from a teammate."""
        os.pwrite(self._file, _SLOT.pack(number), _FINGERPRINT + sender * _SLOT.size)
        self._synced = False

    def sync(self) -> None:
        """Wait until the disk has all that was written."""
        if not self._synced:
            os.fdatasync(self._file)
            self._synced = True

    def close(self) -> None:
        """Close and unlock the file; later calls do nothing."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
