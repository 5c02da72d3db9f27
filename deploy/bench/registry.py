"""All benchmarks by name, and the function that runs them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from deploy.bench.field import field
from deploy.bench.kernels import kernels
from deploy.bench.measurement import Measurement
from deploy.bench.peers import peers
from deploy.bench.relay import relay
from deploy.bench.replanning import replanning
from deploy.bench.scale import ROBOTS, STRATEGIES, scale
from deploy.bench.swarm import swarm

_ALL = (kernels, swarm, replanning, relay, scale, field, peers)
BENCHMARKS: dict[str, Callable[[], Iterator[Measurement]]] = {each.__name__: each for each in _ALL}

ON_REQUEST = ("peers",)
"""Benchmarks that take minutes, and so run only if they are named."""


def run_benchmarks(
    names: Sequence[str],
    report: Callable[[str], object],
    robots: Sequence[int] = (),
    strategies: Sequence[str] = (),
) -> list[dict[str, Any]]:
    """Run benchmarks, all but those `ON_REQUEST` if `names` is empty; `report` each line as soon as it is there.

    `robots` and `strategies` replace the defaults of ``scale`` if they are not empty. Raises ValueError if a name is
    unknown.
    """
    unknown = [name for name in names if name not in BENCHMARKS]
    if unknown:
        raise ValueError(f"no benchmark is called {unknown[0]!r}; there are: {', '.join(BENCHMARKS)}")
    known = BENCHMARKS | {"scale": partial(scale, robots or ROBOTS, strategies or STRATEGIES)}
    measurements = []
    for name in names or (name for name in BENCHMARKS if name not in ON_REQUEST):
        report(f"{name}:")
        for measurement in known[name]():
            report("  " + measurement.line())
            measurements.append({"bench": name, **asdict(measurement)})
    return measurements
