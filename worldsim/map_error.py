"""The error of maps that cannot be read, drawn or used."""

from __future__ import annotations


class MapError(ValueError):
    """A map is invalid; the message names the place, the error and a remedy."""
