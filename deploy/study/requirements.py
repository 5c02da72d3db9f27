"""What runs must meet so that a team or a radio suffices for a building (`murmur size`)."""

from __future__ import annotations

from dataclasses import dataclass

from deploy.scenario.errors import ScenarioError
from deploy.study.results import Row
from deploy.study.tables import has_finished
from protocol.errors import shown

MIN_MAP_ACCURACY = 0.95


@dataclass(frozen=True)
class Requirements:
    """Requirements of a run."""

    deadline: int | None = None
    """Maximum number of steps; None: any number."""
    min_map_accuracy: float = MIN_MAP_ACCURACY
    """Minimum share of correct cells on the map of the first robot, or of the worst one (`finish`)."""
    finish: str = "all"
    """Which robots must finish with an accurate map: ``first`` or ``all``."""

    def __post_init__(self) -> None:
        """Raise ScenarioError if no run, or each run, would meet them."""
        deadline, accuracy = self.deadline, self.min_map_accuracy
        if deadline is not None and not deadline >= 1:
            raise ScenarioError(f"deadline = {shown(deadline)}: must be a number of steps, at least 1")
        if not 0 <= accuracy <= 1:
            raise ScenarioError(f"min_map_accuracy = {shown(accuracy)}: must be a share from 0 to 1, as 0.95")

    def are_met(self, row: Row) -> bool:
        """Return whether a run meets them."""
        accuracy = row["worst_map_accuracy" if self.finish == "all" else "map_accuracy"] or 0.0
        in_time = self.deadline is None or row["steps"] <= self.deadline
        return has_finished(row) and in_time and accuracy >= self.min_map_accuracy

    def __str__(self) -> str:
        whose = "each robot's map" if self.finish == "all" else "the first robot's map"
        in_time = "" if self.deadline is None else f"within {self.deadline} steps and "
        return f"{in_time}with at least {100 * self.min_map_accuracy:g} % of {whose} correct"
