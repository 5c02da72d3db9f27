"""The error of everything that is read from the air or from a wire, and the words for a name that is not known."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class ProtocolError(ValueError):
    """Malformed bytes.

    Attributes
    ----------
    packet : str
        The packet or message that was being read.
    offset : int
        Where in the buffer it begins, in bytes.
    reason : str
        What is wrong and what would be right.
    """

    def __init__(self, packet: str, offset: int, reason: str) -> None:
        super().__init__(f"{packet} at byte {offset}: {reason}")
        self.packet = packet
        self.offset = offset
        self.reason = reason


def there_are(known: Iterable[str], name: str = "") -> str:
    """What to say where `name` is none of the `known` names: those that are near, then all."""
    stems = {each.removesuffix(".toml"): each for each in known}
    near = difflib.get_close_matches(name.lower().removesuffix(".toml"), stems)
    meant = (
        f"did you mean {' or '.join(stems[stem] for stem in near)}? There are: " if near else "there are: "
    )
    return meant + ", ".join(stems.values())
