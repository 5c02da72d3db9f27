"""Figures as ratios against yardsticks of the same run, and the benches that yield them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from protocol.keyed_random import keyed_random

RESAMPLES = 2000


@dataclass(frozen=True)
class Figure:
    """One measured figure.

    Attributes
    ----------
    name, unit : str
        What is measured, and its unit.
    value : float
        The median over repeats.
    yardstick : str
        What it is compared with; empty if nothing.
    ratio : float or None
        Value over yardstick, in the median.
    interval : (float, float) or None
        95 % bootstrap interval of that median ratio.
    aim : str
        The target value, in words.
    """

    name: str
    unit: str
    value: float
    yardstick: str = ""
    ratio: float | None = None
    interval: tuple[float, float] | None = None
    aim: str = ""

    def line(self) -> str:
        """The figure as a line of text."""
        text = f"{self.name:44} {self.value:12,.2f} {self.unit:10}"
        if self.ratio is not None:
            text += f" {self.ratio:6.2f} x {self.yardstick}"
            if self.interval is not None:
                text += f" [{self.interval[0]:.2f}, {self.interval[1]:.2f}]"
        return text.rstrip() + (f"   (aim: {self.aim})" if self.aim else "")


def compare(
    name: str, unit: str, values: Sequence[float], yardstick: str, against: Sequence[float], aim: str = ""
) -> Figure:
    """Make a figure from paired repeats: values, and those of the yardstick."""
    ratios = np.array(values, float) / np.array(against, float)
    draws = keyed_random(0, "bootstrap").integers(len(ratios), size=(RESAMPLES, len(ratios)))
    medians = np.median(ratios[draws], axis=1)
    low, high = (float(edge) for edge in np.percentile(medians, [2.5, 97.5]))
    return Figure(name, unit, float(np.median(values)), yardstick, float(np.median(ratios)), (low, high), aim)


Bench = Callable[[], Iterator[Figure]]


def benches() -> dict[str, Bench]:
    """All benches, by name."""
    from deploy.bench import cold_cache, hosts, kernels, relay, replanning, scale, swarm  # noqa: PLC0415

    return {
        "kernels": kernels.kernels,
        "bus": swarm.bus,
        "swarm": swarm.swarm,
        "cold-cache": cold_cache.cold_cache,
        "replanning": replanning.replanning,
        "relay": relay.relay,
        "scale": scale.scale,
        "link": hosts.link,
        "hub": hosts.hub,
    }


def run_benches(
    names: Sequence[str], tell: Callable[[str], object], robots: Sequence[int] = ()
) -> list[dict[str, Any]]:
    """Run the benches called `names` (none: all), reporting each figure as it is measured.

    `robots` are the team sizes that ``scale`` measures; none: its own.

    Raises
    ------
    ValueError
        There is no bench of that name.
    """
    known = benches()
    if robots:
        from deploy.bench.scale import scale  # noqa: PLC0415

        known["scale"] = partial(scale, robots)
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(f"no bench is called {unknown[0]!r}; there are: {', '.join(known)}")
    figures = []
    for name in names or known:
        tell(f"{name}:")
        for figure in known[name]():
            tell("  " + figure.line())
            figures.append({"bench": name, **asdict(figure)})
    return figures
