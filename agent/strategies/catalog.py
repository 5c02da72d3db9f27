"""Descriptions of all strategies, for `murmur strategies`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint

from agent.strategies.base import Strategy
from agent.strategies.options import OptionLine, option_lines
from agent.strategies.registry import PLUGINS, strategies, strategy
from protocol.plugins import package

COMBINING = """\
A strategy consists of parts. Each strategy has defaults; options replace them:

  candidates   the goals among the frontier cells
    cells          all frontier cells
    rfe            representatives of frontier segments
    anr            representatives, at least as many as robots
    breadth-first  the nearest cell that no teammate drives to
    hops           the same, in steps to any of eight neighbors
    edges          representatives of all frontier segments, small ones included (repairmen)
  costs        the cost of a way
    shortest       its length
    weighted       its length times the occupancy of a smoothed map
  replan       when to choose a new target
    at-goal        at the target
    at-once        when the target is no frontier any more
    after-turn     at the target, after a full turn of the scanner
    each-step      in every step that changes the map (repairmen)
  mission      the end of the run
    open           the first robot has nothing left to explore
    return         all robots have driven home
  scan         when scanners work
    always         also on the way
    at-target      only at targets
  share        when map changes are sent to teammates
    always         at once
    at-target      when a target is reached or replaced

Combinations that conflict are rejected with the reason: breadth-first with
weighted costs, with strategies that compare several goals, or with teams;
after-turn with teams; scan = at-target without after-turn; mtsp on all cells;
the depot strategies on open missions; any part with the potential field."""


@dataclass(frozen=True)
class Entry:
    """Description of one strategy."""

    name: str
    summary: str
    source: str
    """`name`, `summary`, `source`: name, one line of description, and paper with section."""
    options: list[OptionLine]
    """The options with their defaults."""
    refused: Mapping[str, str]
    """Options of other strategies that do not apply."""
    clashes: list[str]
    """Errors of option values that conflict with the defaults of the other options."""

    @property
    def paper(self) -> str:
        """The paper, as authors and year."""
        return self.source.partition(", ")[0]

    @property
    def section(self) -> str:
        """The section of the paper."""
        return self.source.partition(", ")[2]


def catalog() -> list[Entry]:
    """Return all strategies by name: of this package, and of installed packages."""
    found = {name: _entry(kind) for name, kind in strategies().items()}
    found |= {name: _entry_of(point) for name, point in PLUGINS.installed().items()}
    return [found[name] for name in sorted(found)]


def entry(name: str) -> Entry:
    """Return the strategy with this name, or the class ``package.module:Class``; ValueError if there is none."""
    return _entry(strategy(name))


def _entry_of(point: EntryPoint) -> Entry:
    """Describe the strategy of an installed package; if its import fails, the summary has the reason."""
    try:
        return _entry(PLUGINS.load(point))
    except ValueError as error:
        reason = str(error).splitlines()[-1]
        return Entry(point.name, f"cannot be imported: {reason}", f"package {package(point)}", [], {}, [])


def _entry(kind: type[Strategy]) -> Entry:
    lines = option_lines(kind.options_type)
    return Entry(kind.name, kind.summary, kind.source, lines, kind.refused, _clashes(kind, lines))


def _clashes(kind: type[Strategy], lines: list[OptionLine]) -> list[str]:
    found = []
    for line in lines:
        for choice in line.choices:
            try:
                kind.check({line.name: choice})
            except ValueError as error:
                found.append(str(error))
    return found
