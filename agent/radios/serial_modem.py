"""Transport over a serial port with a frame modem: each line (`agent.radios.cobs`) is one frame on the air.

The port is a terminal device of POSIX in raw mode, 8 data bits, no parity, one stop bit. A modem must send each line
that it receives as one frame, and write each received frame as one line; docs/field.md says how modems are set up.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import stat
import termios
import tty
from pathlib import Path

from agent.radios.cobs import LineReader, line
from agent.radios.transport import MAX_PER_CALL, TransportError

BAUD_RATES = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400)

_CHUNK, _CHUNKS = 1 << 12, 64
"""Bytes of one read, and reads of one call of `SerialModem.receive` at most."""


def check_port(port: Path) -> None:
    """Raise TransportError if there is no such port, or this process may not use it; it is not opened.

    To open a port resets some modems.
    """
    try:
        mode = port.stat().st_mode
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise TransportError(f"port {port}: {reason}") from None
    if not stat.S_ISCHR(mode):
        raise TransportError(f"port {port} is no serial port")
    if not os.access(port, os.R_OK | os.W_OK):
        raise TransportError(f"port {port}: {os.strerror(errno.EACCES)}")


class SerialModem:
    """A modem at a serial port such as ``/dev/ttyUSB0``, with one of `BAUD_RATES`, and frames of up to `longest` bytes.

    TransportError: the port is missing, is no terminal, or is in use, or the rate is unknown.
    """

    def __init__(self, port: Path, baud: int, longest: int) -> None:
        if baud not in BAUD_RATES:
            raise TransportError(f"baud = {baud}: must be one of {', '.join(map(str, BAUD_RATES))}")
        self._longest = longest
        self._path, self._baud = port, baud
        self._reader = LineReader(longest)
        self._arrived: list[bytes] = []
        """Frames that `receive` has not returned yet."""
        self._unsent = b""
        """The rest of a line that the port had no room for."""
        self._closed = False
        self._port = self._open()

    @property
    def damaged(self) -> int:
        """Lines that were dropped because their checksum was wrong, or they were malformed or too long."""
        return self._reader.damaged

    def send(self, frame: bytes) -> bool:
        """Write a frame; return False if it is too long, the port still holds the last one, or the modem is gone.

        A modem that was unplugged is opened again if it is back.
        """
        if self._port < 0 and not self._closed:
            with contextlib.suppress(TransportError):
                self._port = self._open()
        if len(frame) > self._longest or not self._flush():
            return False
        self._unsent = line(frame)
        self._flush()
        return True

    def receive(self) -> list[bytes]:
        """Return the frames that have arrived; a modem that is gone receives nothing."""
        self._flush()
        for _ in range(_CHUNKS):
            if self._port < 0 or len(self._arrived) >= MAX_PER_CALL:
                break
            try:
                data = os.read(self._port, _CHUNK)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                data = b""
            if not data:
                self._hang_up()
            self._arrived += self._reader.feed(data)
        frames, self._arrived = self._arrived[:MAX_PER_CALL], self._arrived[MAX_PER_CALL:]
        return frames

    def fileno(self) -> int:
        """Return the file descriptor of the port; -1 while the modem is gone."""
        return self._port

    def close(self) -> None:
        """Close the port."""
        self._closed = True
        self._hang_up()

    def _open(self) -> int:
        """Open and lock the port, and set it to raw mode; return its file descriptor."""
        try:
            port = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise TransportError(f"port {self._path}: {error.strerror}") from None
        except ValueError as error:
            raise TransportError(f"port {str(self._path)!r}: {error}") from None
        try:
            fcntl.flock(port, fcntl.LOCK_EX | fcntl.LOCK_NB)
            tty.setraw(port, termios.TCSANOW)
            settings = termios.tcgetattr(port)
            settings[2] |= termios.CLOCAL | termios.CREAD
            settings[4] = settings[5] = getattr(termios, f"B{self._baud}")
            termios.tcsetattr(port, termios.TCSANOW, settings)
            termios.tcflush(port, termios.TCIFLUSH)
        except BlockingIOError:
            os.close(port)
            raise TransportError(f"port {self._path} is in use by another process") from None
        except (termios.error, OSError) as error:
            os.close(port)
            raise TransportError(f"port {self._path} is no serial port: {error.args[-1]}") from None
        return port

    def _hang_up(self) -> None:
        """Close the port, whose modem is gone, or is not needed any more."""
        if self._port >= 0:
            os.close(self._port)
            self._port = -1
        self._unsent = b""

    def _flush(self) -> bool:
        """Write what the port has room for; return whether it may take another line."""
        if self._port < 0:
            return False
        try:
            self._unsent = self._unsent[os.write(self._port, self._unsent) :]
        except (BlockingIOError, InterruptedError):
            return False
        except OSError:
            self._hang_up()
            return False
        return not self._unsent
