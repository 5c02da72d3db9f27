"""Topology: which robots receive each other in a step, by position, radio model, partitions and faults."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from netshaper import connectivity
from netshaper.radio_models import PLUGINS, checked
from netshaper.settings import RadioSettings
from protocol.grid import Cell


class Topology:
    """The links of a step."""

    def __init__(self) -> None:
        self.in_range: dict[int, list[int]] = {}
        """For each robot that takes part in the step, the robots in its range, ascending."""
        self.dead: set[int] = set()
        """Robots that do not answer anymore."""
        self.mute: set[int] = set()
        """Robots whose radios cannot send."""
        self.deaf: set[int] = set()
        """Robots whose radios cannot receive."""
        self.absent: set[int] = set()
        """Robots that missed a phase of this step; they take no part in the rest of its phases, but receive."""
        self.late: set[int] = set()
        """Robots that missed a phase in any step; their answers may still come."""

    def begin(
        self,
        settings: RadioSettings,
        step: int,
        cells: Mapping[int, Cell],
        mute: Iterable[int],
        deaf: Iterable[int],
    ) -> None:
        """Begin a step, with the true cell (x, y) of each robot."""
        self.mute, self.deaf, self.absent = set(mute), set(deaf), set()
        self.in_range = links(settings, step, {r: cell for r, cell in cells.items() if r not in self.dead})

    def living(self) -> list[int]:
        """Return the robots that take part in the step and are not dead."""
        return sorted(self.in_range.keys() - self.dead)

    def participants(self) -> list[int]:
        """Return the living robots that have missed no phase of the step."""
        return sorted(self.in_range.keys() - self.dead - self.absent)

    def note_missed(self, robots: Iterable[int]) -> None:
        """Note that robots have missed a phase of this step."""
        self.absent.update(robots)
        self.late |= self.absent

    def detected_by(self, robot: int) -> list[int]:
        """Return the teammates in range that a robot can detect."""
        if robot in self.deaf:
            return []
        return [peer for peer in self.in_range[robot] if peer not in self.dead and peer not in self.mute]

    def receivers_of(self, sender: int) -> list[int]:
        """Return the robots that receive the broadcasts of a robot."""
        receiving = self.receiving()
        return [peer for peer in self.in_range[sender] if peer in receiving]

    def receiving(self) -> set[int]:
        """Return the robots that take part in the step, are not dead, and whose radios can receive."""
        return self.in_range.keys() - self.dead - self.deaf


def links(settings: RadioSettings, step: int, cells: Mapping[int, Cell]) -> dict[int, list[int]]:
    """Return for each robot the robots in its range, by the radio's model and the partitions of a step."""
    options = settings.options
    robots, places = sorted(cells), connectivity.places_of(cells)
    model = PLUGINS.find(options.model)()
    receives = checked(model.links(settings, step, places), options.model, len(robots))
    if options.partition:
        receives = receives & connectivity.parted(robots, options.partition, step)
    return connectivity.named(robots, receives)
