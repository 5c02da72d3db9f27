"""Options of the `predictive` encoding."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal


@dataclass(frozen=True)
class PredictiveOptions:
    """Options of the `predictive` encoding.

    Attributes
    ----------
    base : str
        The map from which a robot predicts its scans. ``team``: its own updates and all that it has received.
        ``own``: its own updates; each log can then be decoded alone, and takes up to three times the bytes.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    base: Literal["team", "own"] = "team"
