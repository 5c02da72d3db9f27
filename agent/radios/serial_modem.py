"""Transport over a serial port with a frame modem: each line (`agent.radios.cobs`) is one frame on the air.

The port is a terminal device of POSIX in raw mode, 8 data bits, no parity, one stop bit. A modem must send each line
that it receives as one frame, and write each received frame as one line; docs/field.md says how modems are set up.
"""

from __future__ import annotations

import errno
import fcntl
import os
import termios
import tty
from pathlib import Path

from agent.radios.cobs import LineReader, line
from agent.radios.transport import MAX_PER_CALL, TransportError

BAUD_RATES = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400)

_CHUNK = 1 << 14
_NOTHING_NOW = (errno.EAGAIN, errno.EINTR, errno.EIO, errno.ENXIO, errno.ENODEV)
"""Errors of a port that is full, has nothing to read, or has been unplugged."""


class SerialModem:
    """A modem at a serial port.

    Parameters
    ----------
    port : path
        For example ``/dev/ttyUSB0``.
    baud : int
        One of `BAUD_RATES`.
    longest : int
        Bytes of the longest frame of the modem.

    Raises
    ------
    TransportError
        The port is missing, is no terminal, or is in use, or the rate is unknown.
    """

    def __init__(self, port: Path, baud: int, longest: int) -> None:
        if baud not in BAUD_RATES:
            raise TransportError(f"baud = {baud}: must be one of {', '.join(map(str, BAUD_RATES))}")
        self.longest = longest
        self._reader = LineReader(longest)
        self._unsent = b""
        """The rest of a line that the port had no room for."""
        try:
            self._port = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise TransportError(f"port {port}: {error.strerror}") from None
        try:
            self._configure(port, baud)
        except Exception:
            os.close(self._port)
            raise

    @property
    def damaged(self) -> int:
        """Lines that were dropped because their checksum was wrong, or they were malformed or too long."""
        return self._reader.damaged

    def send(self, frame: bytes) -> bool:
        """Write a frame; return False if it is too long, or the port still holds the last one."""
        if len(frame) > self.longest or not self._flush():
            return False
        self._unsent = line(frame)
        self._flush()
        return True

    def receive(self) -> list[bytes]:
        """Return the frames that have arrived; a modem that was unplugged neither receives nor sends."""
        self._flush()
        frames: list[bytes] = []
        while self._port >= 0 and len(frames) < MAX_PER_CALL:
            try:
                data = os.read(self._port, _CHUNK)
            except OSError as error:
                if error.errno not in _NOTHING_NOW:
                    raise
                break
            if not data:
                break
            frames += self._reader.feed(data)
        return frames

    def fileno(self) -> int:
        """Return the file descriptor of the port."""
        return self._port

    def close(self) -> None:
        """Close the port."""
        if self._port >= 0:
            os.close(self._port)
            self._port = -1

    def _configure(self, port: Path, baud: int) -> None:
        """Lock the port and set it to raw mode."""
        try:
            fcntl.flock(self._port, fcntl.LOCK_EX | fcntl.LOCK_NB)
            tty.setraw(self._port, termios.TCSANOW)
            settings = termios.tcgetattr(self._port)
            settings[2] |= termios.CLOCAL | termios.CREAD
            settings[4] = settings[5] = getattr(termios, f"B{baud}")
            termios.tcsetattr(self._port, termios.TCSANOW, settings)
            termios.tcflush(self._port, termios.TCIFLUSH)
        except BlockingIOError:
            raise TransportError(f"port {port} is in use by another process") from None
        except (termios.error, OSError) as error:
            raise TransportError(f"port {port} is no serial port: {error}") from None

    def _flush(self) -> bool:
        """Write what the port has room for; return whether it may take another line."""
        if self._port < 0:
            return False
        try:
            self._unsent = self._unsent[os.write(self._port, self._unsent) :]
        except OSError as error:
            if error.errno not in _NOTHING_NOW:
                raise
            return False
        return not self._unsent
