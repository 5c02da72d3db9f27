"""The interface of all exchanges."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from typing import Any, ClassVar

from agent.encodings.reachability_check import ReachabilityCheck, Reception
from agent.outline.polygons import Polygons
from agent.replication.log import Dependency
from agent.replication.map_ids import MapId, map_ids
from agent.settings import Settings
from protocol.grid import Grid
from protocol.scans import Change, Scan


class MapEncoding(ABC):
    """What a robot tells of its own map, and what it makes of what others tell."""

    name: ClassVar[str]
    revisable: int = 0
    """Packets of the last unit that would be told otherwise by now (`retract`); 0: what is logged stands."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.maps = map_ids(settings.robots, settings.incarnations)
        """All maps of the team, by number."""
        self.reachability_check = ReachabilityCheck(settings)
        """What teammates can have seen by now."""

    @classmethod
    def guesses(cls, settings: Settings) -> bool:
        """Whether planning grids hold more than was told: then "nothing is left" must hold for a while."""
        del settings
        return False

    @property
    def polygons(self) -> Mapping[int, Polygons]:
        """What is held of each robot's approximation, one's own too; a new object whenever it changes."""
        return {}

    def share(self, common: dict[str, Any]) -> None:
        """Hold what follows from what was heard, and from nothing else, together with the other robots of this process.

        `common` is theirs; called before the first step, if at all. Nothing that is told or held is any different.
        """
        del common

    @abstractmethod
    def record(self, own: Grid, scan: Scan, change: Change, *, delivered: bool) -> list[bytes]:
        """Return the units (one packet each) that tell of this step's news of the robot's own map.

        `own` is the self-explored grid with `scan` drawn on it; `change` says where it changed.
        `delivered` tells whether there are teammates in range who all hold what was logged before.
        """

    def retract(self) -> None:
        """Take the last unit back, of which nobody has heard anything: its `revisable` packets leave the log."""
        self.revisable = 0

    @abstractmethod
    def take(self, map_id: MapId, frame: bytes, reception: Reception) -> None:
        """Decode the next entries of a map's log, in order.

        Raises
        ------
        ProtocolError
            They are malformed, or describe more than their author can have observed
            (`agent.encodings.reachability_check`); nothing has changed.
        """

    @abstractmethod
    def merge(self, own: Grid, peers: Collection[int] = ()) -> Grid:
        """Return the planning grid: what all have told, and the robot's own grid, which counts most.

        It is written over by the next call. All that changes `own` in between has been recorded.
        `peers` are the teammates in range: what they have told so far they can still correct.
        """

    def pose(self, map_id: MapId) -> tuple[int, int] | None:
        """Return the cell (x, y) of the author's last scan, if the entries of its map contain it."""
        del map_id
        return None

    def dependencies(self, number: int) -> Sequence[Dependency]:
        """Return the decoded log ranges of a map, by its number, that depend on entries of other logs; in order."""
        del number
        return ()

    def error(self, own: Grid) -> int:
        """Cells in which `own` and what one has told of it differ (d(t) of Eq. 6.1); none where scans travel."""
        del own
        return 0

    def exact_error(self, own: Grid) -> int | None:
        """What `error` would be if what was told were exact; None if that is not measured."""
        del own
        return None
