"""The hub of the bus: the relay's own zenoh session, with access control."""

from __future__ import annotations

import contextlib
import re
import resource
from collections.abc import Iterator, Mapping

import zenoh

from netshaper import access
from protocol import keys as names
from protocol.keys import Keys
from protocol.message_fields import MAX_FRAMES, MAX_ROBOT_PAYLOAD
from protocol.temporary import temporary_folder
from protocol.zenoh_bus import Certificate, Credential, ZenohBus, insert, plain_config, receive_apart, use_tls

MAX_MESSAGE_BYTES = MAX_ROBOT_PAYLOAD + (1 << 16)
"""Maximum size of a message to the hub; it drops a longer one, and its sender times out."""
MAX_FILES, FILES_OF_PARTICIPANTS = 1 << 16, 1 << 11
"""Maximum number of open files of the hub, and those of them that half-open connections leave to others."""
ACCEPT_TIMEOUT_MS = 5000
"""Time limit for a client to authenticate; then the hub closes the connection."""


def open_hub(
    run: str, endpoint: str, credentials: Mapping[str, Credential], certificate: Certificate | None = None
) -> ZenohBus:
    """Listen at `endpoint` for the holders of `credentials`: all clients of the run, including routers.

    At ``tcp/HOST:PORT`` clients authenticate with passwords. At ``tls/HOST:PORT`` the hub shows its own `certificate`;
    clients need a certificate of the same authority with a participant's name as common name.

    Raises ConnectionError if the hub cannot listen at this address.
    """
    keys = Keys(run)
    config = listening(endpoint, MAX_MESSAGE_BYTES)
    by = access.PASSWORDS if certificate is None else access.CERTIFICATES
    represented = {name: each.robots or (name,) for name, each in credentials.items()}
    insert(config, "access_control", access.rules(keys, represented, by))
    receive_apart()
    if certificate is not None:
        use_tls(config, certificate, "listen")
    with password_check(config, {} if certificate is not None else credentials):
        try:
            session = zenoh.open(config)
        except zenoh.ZError as error:
            raise ConnectionError(f"the hub cannot listen at {endpoint}: {_reason(error)}") from None
    return ZenohBus(session, keys, names.RELAY)


def listening(endpoint: str, most_bytes: int = MAX_FRAMES + (1 << 20)) -> zenoh.Config:
    """Return the configuration of a hub or router, which listens at one endpoint, and routes messages up to a size."""
    config = plain_config("router")
    insert(config, "listen/endpoints", [endpoint])
    insert(config, "transport/link/rx/max_message_size", most_bytes)
    insert(config, "transport/unicast/accept_pending", _allow_half_open())
    insert(config, "transport/unicast/accept_timeout", ACCEPT_TIMEOUT_MS)
    return config


def _allow_half_open() -> int:
    """Raise the process's limit of open files; return the number of half-open connections that the hub admits."""
    files, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    allowed = MAX_FILES if most == resource.RLIM_INFINITY else min(most, MAX_FILES)
    if 0 <= files < allowed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, most))
    return max(allowed - FILES_OF_PARTICIPANTS, allowed // 2)


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
