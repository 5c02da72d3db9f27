"""The session file of a robot: the sessions and frame numbers that must survive a restart.

A robot writes the number of its session before it sends the first frame of it, so no frame number is used twice. It
writes the highest frame number of each teammate when it accepts a frame, so no frame is accepted again after a restart.

The file has the fingerprint of the key, 8 bytes, and for each robot of the team the highest frame number, as a
big-endian u64; this robot's own slot holds its session. With another key, all numbers begin anew. A file that is
neither empty nor of this form is refused: if it was damaged, numbers could repeat under the same key.

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
    """The session file of one robot, locked while it is open.

    Raises
    ------
    SessionFileError
        Another process has the file open, it is damaged or belongs to another team, or the robot has used up its
        sessions.
    """

    def __init__(self, path: Path, key: bytes, robot: int, robots: int) -> None:
        self._path = path
        self._robot = robot
        self._size = _FINGERPRINT + robots * _SLOT.size
        self._synced = True
        """Whether the disk has all numbers."""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        except OSError as error:
            raise SessionFileError(f"{path}: {error.strerror}") from None
        try:
            self._begin(hashlib.sha256(b"murmur session file" + key).digest()[:_FINGERPRINT])
        except Exception:
            os.close(self._file)
            raise

    def _begin(self, fingerprint: bytes) -> None:
        """Lock the file, read it, and write the number of a new session."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise SessionFileError(f"{self._path} is in use: another process runs as this robot") from None
        length = os.fstat(self._file).st_size
        data = os.pread(self._file, self._size, 0)
        if length and (length <= _FINGERPRINT or (length - _FINGERPRINT) % _SLOT.size):
            raise SessionFileError(
                f"{self._path} is no session file, or damaged ({length} bytes): create a new team key"
            )
        if data[:_FINGERPRINT] != fingerprint:
            data = fingerprint + bytes(self._size - _FINGERPRINT)
        elif length != self._size:
            reason = f"{length} bytes instead of {self._size}, so it belongs to a team of another size"
            raise SessionFileError(f"{self._path} has {reason}: create a new team key")
        numbers = [number for (number,) in _SLOT.iter_unpack(data[_FINGERPRINT:])]
        self.session = (numbers[self._robot] >> COUNTER_BITS) + 1
        """The number of this session, from 1; no earlier session with this key had it."""
        if self.session > MAX_SESSION:
            raise SessionFileError(f"{self._path}: {MAX_SESSION} sessions are used up: create a new team key")
        if max(numbers) > frame_number(MAX_SESSION, MAX_COUNTER):
            reason = f"damaged: no frame has the number {max(numbers)}"
            raise SessionFileError(f"{self._path} is {reason}; create a new team key")
        numbers[self._robot] = frame_number(self.session, 0)
        self.highest = {robot: number for robot, number in enumerate(numbers) if robot != self._robot}
        """The highest frame number accepted from each teammate before this session; 0 for none."""
        os.pwrite(self._file, fingerprint + b"".join(map(_SLOT.pack, numbers)), 0)
        os.ftruncate(self._file, self._size)
        os.fsync(self._file)
        folder = os.open(self._path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

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
