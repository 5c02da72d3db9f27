"""The protocol errors of a run: all are counted, and the text of the first ones of each sender is kept."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

MAX_TEXTS = 1000
"""Number of errors of each sender of which the text is kept."""


@dataclass
class ProtocolErrors:
    """Protocol errors by sender."""

    texts: list[str] = field(default_factory=list)
    """Sender and text of the first `MAX_TEXTS` errors of each sender, in the order of arrival."""
    counts: Counter[str] = field(default_factory=Counter)
    """Number of errors of each sender."""

    @property
    def total(self) -> int:
        """Number of errors of all senders."""
        return self.counts.total()

    def add(self, sender: str, text: str) -> None:
        """Record an error of a sender."""
        self.counts[sender] += 1
        if self.counts[sender] <= MAX_TEXTS:
            self.texts.append(f"{sender}: {text}")
