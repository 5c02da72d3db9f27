"""The hub of the bus: the relay's own zenoh session, with access control."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping

import zenoh

from netshaper import access
from protocol import keys as names
from protocol.keys import Keys
from protocol.messages import MAX_FRAMES
from protocol.temporary import temporary_folder
from protocol.zenoh_bus import Certificate, Credential, ZenohBus, insert, plain_config, receive_apart, use_tls

MAX_MESSAGE_BYTES = MAX_FRAMES + (1 << 20)
"""Maximum size of a message to the hub; the hub disconnects the sender of a longer one."""


def open_hub(
    run: str, endpoint: str, credentials: Mapping[str, Credential], certificate: Certificate | None = None
) -> ZenohBus:
    """Listen at `endpoint` for the holders of `credentials`: all clients of the run, including routers.

    At ``tcp/HOST:PORT`` clients authenticate with passwords. At ``tls/HOST:PORT`` the hub shows its own `certificate`;
    clients need a certificate of the same authority with a participant's name as common name.

    Raises
    ------
    ConnectionError
        The hub cannot listen at this address.
    """
    keys = Keys(run)
    config = listening(endpoint)
    by = access.PASSWORDS if certificate is None else access.CERTIFICATES
    insert(config, "access_control", access.rules(keys, access.represented(credentials), by))
    if certificate is not None:
        receive_apart()
        use_tls(config, certificate, "listen")
    with password_check(config, {} if certificate is not None else credentials):
        try:
            session = zenoh.open(config)
        except zenoh.ZError as error:
            raise ConnectionError(f"the hub cannot listen at {endpoint}: {_reason(error)}") from None
    return ZenohBus(session, keys, names.RELAY)


def listening(endpoint: str) -> zenoh.Config:
    """Return the configuration of a hub or router, which routes and listens at one endpoint."""
    config = plain_config("router")
    insert(config, "listen/endpoints", [endpoint])
    insert(config, "transport/link/rx/max_message_size", MAX_MESSAGE_BYTES)
    return config


@contextlib.contextmanager
def password_check(config: zenoh.Config, credentials: Mapping[str, Credential]) -> Iterator[None]:
    """Make a session that is opened in this context check the passwords of `credentials`, if there are any."""
    with temporary_folder() as folder:
        if credentials:
            dictionary = folder / "passwords"
            dictionary.touch(mode=0o600)
            dictionary.write_text("".join(f"{c.name}:{c.password}\n" for c in credentials.values()))
            insert(config, "transport/auth/usrpwd/dictionary_file", str(dictionary))
        yield


def _reason(error: zenoh.ZError) -> str:
    """Return the operating system's error message within zenoh's: the part before the first source location."""
    message = re.split(r"(?: \(os error \d+\))? at \S+\.rs:\d+", str(error), maxsplit=1)[0]
    return message.rsplit(": ", 1)[-1]
