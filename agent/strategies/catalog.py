"""What people are told of strategies: `murmur strategies` prints it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint

from agent.plugins import package
from agent.strategies.base import Strategy
from agent.strategies.options import OptionLine, option_lines
from agent.strategies.registry import PLUGINS, strategies, strategy

COMBINING = """\
A strategy is made of parts. Each names its own; options exchange them:

  candidates   which cells are worth going to
    cells          all frontier cells
    rfe            representatives of free edges
    anr            representatives, at least as many as robots
    breadth-first  the nearest that nobody is headed for
    hops           the same, counted in steps to any of eight neighbours
    edges          representatives of all free edges, crumbs included (repairmen)
  costs        how ways are counted
    shortest       by their length
    weighted       by length times occupancy of a smoothed map
  replan       when a new target is chosen
    at-goal        at the target
    at-once        when the target is no frontier any more
    after-turn     at the target, after a full turn of the scanner
    each-step      in every step with news (repairmen)
  mission      what comes after the last target
    open           the run ends with the first robot that has nothing left
    return         all drive home, then it ends
  scan         when scanners work
    always         on the way as well
    at-target      only there
  share        when teammates get what was seen
    always         at once
    at-target      when a target is reached or replaced

What does not combine is refused, with the reason: breadth-first with weighted
costs, with strategies that weigh several goals, or with teams; after-turn with
teams; scan = at-target without after-turn; mtsp on all cells; the depot
strategies on open missions; any of these parts with the potential field."""


@dataclass(frozen=True)
class Entry:
    """One strategy.

    Attributes
    ----------
    name, summary, source : str
    options : list of OptionLine
        With their defaults.
    refused : mapping of option to reason
        Options of others that it cannot have.
    clashes : list of str
        Choices that it cannot have while its other options are the defaults, each with the reason.
    """

    name: str
    summary: str
    source: str
    options: list[OptionLine]
    refused: Mapping[str, str]
    clashes: list[str]

    @property
    def paper(self) -> str:
        """Whose it is."""
        return self.source.partition(", ")[0]

    @property
    def section(self) -> str:
        """Where in the paper it is described."""
        return self.source.partition(", ")[2]


def catalog() -> list[Entry]:
    """All strategies by name: ours, those that have been imported, and those of installed packages."""
    found = {kind.name: _entry(kind) for kind in strategies().values()}
    for name, point in PLUGINS.installed().items():
        if name not in found:
            found[name] = _entry_of(point)
    return [found[name] for name in sorted(found)]


def entry(name: str) -> Entry:
    """The strategy of that name, or the class that ``package.module:Class`` names; ValueError if there is none."""
    return _entry(strategy(name))


def _entry_of(point: EntryPoint) -> Entry:
    """The strategy of an installed package; one that cannot be imported is told as that."""
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
