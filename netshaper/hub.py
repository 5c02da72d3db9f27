"""The hub of the bus: the relay's own zenoh session, with access control."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from pathlib import Path

import zenoh

from netshaper import access
from protocol import keys as names
from protocol.keys import Keys
from protocol.zenoh_bus import Credential, ZenohBus, insert, plain_config


def open_hub(run: str, endpoint: str, credentials: Mapping[str, Credential]) -> ZenohBus:
    """Listen at `endpoint` (``tcp/HOST:PORT``) for the holders of `credentials`.

    Raises
    ------
    ConnectionError
        The address cannot be listened at.
    """
    keys = Keys(run)
    robots = len(credentials) - len(access.participants(0))
    config = plain_config("router")
    insert(config, "listen/endpoints", [endpoint])
    insert(config, "access_control", access.rules(keys, robots))
    with tempfile.TemporaryDirectory() as folder:
        dictionary = Path(folder) / "passwords"
        dictionary.touch(mode=0o600)
        dictionary.write_text("".join(f"{c.name}:{c.password}\n" for c in credentials.values()))
        insert(config, "transport/auth/usrpwd/dictionary_file", str(dictionary))
        try:
            session = zenoh.open(config)
        except zenoh.ZError as error:
            raise ConnectionError(f"the hub cannot listen at {endpoint}: {_reason(error)}") from None
    return ZenohBus(session, keys, names.RELAY)


def _reason(error: zenoh.ZError) -> str:
    """The system's error message within zenoh's: the part before the first line of source."""
    words = re.split(r"(?: \(os error \d+\))? at \S+\.rs:\d+", str(error), maxsplit=1)[0]
    return words.rsplit(": ", 1)[-1]
