"""What of the predictive exchange can be chosen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal


@dataclass(frozen=True)
class PredictiveOptions:
    """Options of the predictive exchange.

    Attributes
    ----------
    base : str
        What a unit is built on: ``team``, all that its maker has heard; ``own``, what it has told itself. Then each
        map stands alone, and costs up to three times as much.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    base: Literal["team", "own"] = "team"
