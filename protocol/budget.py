"""A number of bytes that may be sent, or no limit at all."""

from __future__ import annotations

from typing import Annotated

import msgspec

WORD_FOR_UNLIMITED = "unlimited"
"""How scenarios, options and output write that there is no limit."""


class Budget(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, gc=False):
    """Bytes that may be sent; also a field of messages."""

    limit: Annotated[int, msgspec.Meta(ge=0, lt=2**53)] | None
    """Number of bytes; None if there is no limit."""

    @classmethod
    def parse(cls, value: int | str) -> Budget:
        """Read a budget as scenarios write it: a number of bytes, or ``unlimited``; ValueError if it is neither."""
        if value == WORD_FOR_UNLIMITED:
            return UNLIMITED
        if isinstance(value, str) or value < 0:
            raise ValueError(f"{value!r}: must be {WORD_FOR_UNLIMITED!r} or a number of bytes from 0 on")
        return cls(int(value))

    @property
    def unlimited(self) -> bool:
        """Whether there is no limit."""
        return self.limit is None

    @property
    def spent(self) -> bool:
        """Whether nothing may be sent any more."""
        return self.limit is not None and self.limit <= 0

    def fits(self, size: int) -> bool:
        """Whether so many bytes may be sent."""
        return self.limit is None or size <= self.limit

    def minus(self, size: int) -> Budget:
        """Return the budget that is left once so many bytes are sent, at least 0."""
        if self.limit is None:
            return self
        return Budget(self.limit - size if size < self.limit else 0)

    def least(self, other: Budget) -> Budget:
        """Return the smaller of two budgets."""
        if self.limit is None or other.limit is None:
            return other if self.limit is None else self
        return self if self.limit <= other.limit else other

    def __str__(self) -> str:
        """The budget as scenarios write it."""
        return WORD_FOR_UNLIMITED if self.limit is None else str(self.limit)


UNLIMITED = Budget(None)
"""The budget without a limit."""
