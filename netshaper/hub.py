"""The hub of the bus: the relay's own zenoh session, with access control."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from pathlib import Path

import zenoh

from netshaper import access
from protocol import keys as names
from protocol.fields import MOST_FRAMES
from protocol.keys import Keys
from protocol.zenoh_bus import Certificate, Credential, ZenohBus, insert, mutual_tls, plain_config

MOST_BYTES = MOST_FRAMES + (1 << 20)
"""Of a message that anybody sends to the hub: whoever sends a longer one is cut off."""


def open_hub(
    run: str, endpoint: str, credentials: Mapping[str, Credential], certificate: Certificate | None = None
) -> ZenohBus:
    """Listen at `endpoint` for the holders of `credentials`.

    Passwords are asked for at ``tcp/HOST:PORT``. At ``tls/HOST:PORT`` the hub shows its own `certificate`, and asks for
    one of the same authority whose common name is that of a participant.

    Raises
    ------
    ConnectionError
        The address cannot be listened at.
    """
    keys = Keys(run)
    robots = len(credentials) - len(access.participants(0))
    config = plain_config("router")
    insert(config, "listen/endpoints", [endpoint])
    by = access.PASSWORDS if certificate is None else access.CERTIFICATES
    insert(config, "access_control", access.rules(keys, robots, by))
    insert(config, "transport/link/rx/max_message_size", MOST_BYTES)
    with tempfile.TemporaryDirectory() as folder:
        if certificate is not None:
            insert(config, "transport/link/tls", mutual_tls(certificate, "listen"))
        else:
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
