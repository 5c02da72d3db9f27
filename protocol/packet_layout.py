"""Bit layouts of packets, from which the codec, the packet index, the dissector and the documentation are derived.

A packet starts with a code that no other code begins with. Its fields follow, most significant bit first; the unused
bits of the last byte are zero. Some layouts end with content: bytes of which there are a fixed number, or as many as
the field `length` says. A packet class has one layout, or several if its content has (`protocol.packets.LAYOUTS`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

LENGTH = "length"
"""Name of the field that holds the number of bytes of content. It directly follows the code."""


@dataclass(frozen=True, slots=True)
class Bits:
    """Encoding of a field: an unsigned integer."""

    width: int
    """Number of bits."""
    letter: str
    """Stands for these bits in drawings of the layout."""
    meaning: str
    """Value of the field, for the documentation."""
    bias: int = 0
    """Number that is added to the value before it is sent."""


@dataclass(frozen=True)
class Layout:
    """One form in which a packet is sent."""

    packet: str
    """Name of the packet's class."""
    kind: str
    """Kind by which ledger and reports count it."""
    size: int
    """Bytes before the content, which some layouts do not have."""
    code: str
    """Binary digits with which the packet starts."""
    fields: tuple[tuple[str, Bits], ...]
    """Names and encodings of the fields, in the order in which they are sent."""
    content: tuple[int, int] | None = None
    """The least and the most bytes of content; None: the packet has none."""

    @cached_property
    def has_length(self) -> bool:
        """Whether a field gives the bytes of content."""
        return any(name == LENGTH for name, _ in self.fields)

    @property
    def spare(self) -> int:
        """Bits at the end that are zero."""
        if self.content is not None:
            return 0
        return 8 * self.size - len(self.code) - sum(bits.width for _, bits in self.fields)

    @cached_property
    def fixed(self) -> tuple[int, int]:
        """Mask of the bits that are equal in all packets of this layout, code and spare bits, and their value."""
        behind = 8 * self.size - len(self.code)
        code_mask = (1 << len(self.code)) - 1 << behind
        return code_mask | (1 << self.spare) - 1, int(self.code, 2) << behind

    @cached_property
    def places(self) -> tuple[tuple[str, int, int, int], ...]:
        """For each field its name, left shift, mask (before the shift) and bias."""
        shift = 8 * self.size - len(self.code)
        places = []
        for name, bits in self.fields:
            shift -= bits.width
            places.append((name, shift, (1 << bits.width) - 1, bits.bias))
        return tuple(places)

    @property
    def shifts(self) -> tuple[int, ...]:
        """The left shift of each field in the packet, read as one number; kernels write and read packets by them."""
        return tuple(shift for _, shift, _, _ in self.places)

    def starts_with(self, byte: int) -> bool:
        """Whether packets of this layout can start with a byte."""
        known = min(len(self.code), 8)
        return f"{byte:08b}"[:known] == self.code[:known]

    def drawing(self) -> str:
        """Draw the layout in one line: class, kind, bytes, then its bits, with a letter for each bit of a field."""
        groups = [self.code, *(bits.letter * bits.width for _, bits in self.fields)]
        groups += ["0" * self.spare] if self.spare else []
        size = str(self.size)
        if self.content is not None:
            least, most = self.content
            groups.append(
                f"n bytes of content, {least} to {most}" if self.has_length else f"{most} bytes of content"
            )
            size = f"{self.size + least} to {self.size + most}" if least < most else str(self.size + most)
        return f"{self.packet:9} {self.kind:6} {size:8} {' '.join(groups)}"
