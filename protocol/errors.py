"""The error for malformed packets and messages, and the text that suggests known names for an unknown one."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable


class ProtocolError(ValueError):
    """Malformed bytes."""

    def __init__(self, packet: str, offset: int, reason: str) -> None:
        super().__init__(f"{packet} at byte {offset}: {reason}")
        self.packet = packet
        """Kind of the packet or name of the message."""
        self.offset = offset
        """Its first byte in the buffer."""
        self.reason = reason
        """The mistake, and what would be correct."""


_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 200
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = 20
_SHORT.maxlong = 100


def shown(value: object) -> str:
    """Return the `repr` of a wrong value, shortened where it is long or deep."""
    return _SHORT.repr(value)


def there_are(known: Iterable[str], name: str) -> str:
    """Return the end of an error text on an unknown `name`: the most similar of the `known` names, then all."""
    stems = {each.removesuffix(".toml"): each for each in known}
    near = difflib.get_close_matches(name.lower().removesuffix(".toml"), stems)
    meant = (
        f"did you mean {' or '.join(stems[stem] for stem in near)}? There are: " if near else "there are: "
    )
    return meant + ", ".join(stems.values())
