"""The team's key file: 32 random bytes in hexadecimal, which only its owner may read.

All robots of a team have a copy of the same file. Any process that has the key can send frames
in the name of every robot.
"""

from __future__ import annotations

import os
import secrets
import stat
from pathlib import Path

from agent.radios.sealing import KEY_BYTES
from protocol.files import exposure


class KeyFileError(ValueError):
    """A key file is missing, readable by others, or malformed; the message says what to do."""


def create_key(path: Path) -> None:
    """Write a new key to a file that does not exist yet; KeyFileError if it does, or cannot be written."""
    try:
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
    except FileExistsError:
        raise KeyFileError(f"{path} already exists: remove it first, or choose another name") from None
    except OSError as error:
        raise KeyFileError(f"{path}: {error.strerror}") from None
    with os.fdopen(file, "w") as opened:
        os.fchmod(opened.fileno(), 0o600)
        opened.write(secrets.token_hex(KEY_BYTES) + "\n")


def read_key(path: Path) -> bytes:
    """Read a key file.

    KeyFileError: the file is missing, is no regular file, belongs to another user, may be read or written by others, or
    is no key.
    """
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError as error:
        raise KeyFileError(f"{path}: {error.strerror}; copy the team's key file to this robot") from None
    except ValueError as error:
        raise KeyFileError(f"{str(path)!r}: {error}") from None
    try:
        status = os.fstat(file)
        if not stat.S_ISREG(status.st_mode):
            raise KeyFileError(f"{path} is not a regular file")
        if status.st_uid not in (0, os.geteuid()):
            raise KeyFileError(f"{path} belongs to another user (uid {status.st_uid}): chown it to this one")
        if exposed := exposure(path, status.st_mode, "the key"):
            raise KeyFileError(exposed)
        text = os.read(file, 4 * KEY_BYTES)
    finally:
        os.close(file)
    try:
        key = bytes.fromhex(text.decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise KeyFileError(f"{path} is no team key: expected {2 * KEY_BYTES} hexadecimal digits")
    return key
