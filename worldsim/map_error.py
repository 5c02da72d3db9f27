"""The error of maps that cannot be read, drawn or used."""

from __future__ import annotations


class MapError(ValueError):
    """A map that cannot be used: the message says where, what is wrong and what would be right."""
