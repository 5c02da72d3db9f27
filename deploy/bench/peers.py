"""Benchmark of strategies by the rules of other simulators and papers, which docs/peers.md describes.

Each peer's rules are an experiment. The baseline of strategies is exploration of the nearest frontier, and that of
encodings the default one, on the same maps and from the same starts. The benchmark runs the reduced experiments;
``murmur sweep`` runs all.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from deploy.bench.measurement import Measurement, compare
from deploy.study import experiment as experiments
from deploy.study.labels import unit
from deploy.study.results import PLACE, Row
from deploy.study.sweep import as_text, run
from deploy.study.tables import VARIANT, key_of, metric_value


@dataclass(frozen=True)
class Peer:
    """A simulator or paper, and how it measures a team."""

    name: str
    experiment: str
    """File name of the shipped experiment with its rules."""
    metrics: tuple[str, ...]
    baseline: str = "nearest"
    """The variant with which all others are compared."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Values that replace those of the experiment's grid and base."""


PEERS = (
    Peer("DARS 2024", "peer-dars.toml", ("longest_path_95",)),
    Peer("Explore-Bench", "peer-explore-bench.toml", ("t90", "t99", "overlap_sum", "longest_path_99")),
    Peer("MAES", "peer-maes.toml", ("t90", "t99")),
    Peer("MRESim", "peer-mresim.toml", ("t95", "steps")),
    Peer("slam_toolbox", "real-baselines.toml", ("bytes.total",), "predictive", {"map": ["office"]}),
)
"""All peers; docs/peers.md cites the source of their rules."""


def peers(chosen: Sequence[Peer] = PEERS) -> Iterator[Measurement]:
    """Run the reduced experiment of each peer, and measure each of its variants.

    Raises ConnectionError if a run failed, RunFailed if all runs of a peer did.
    """
    for peer in chosen:
        experiment = experiments.quickened(experiments.read(Path(peer.experiment)))
        experiment = experiments.override(experiment, dict(peer.settings))
        swept = run(experiment, jobs=None, scheduler=None, out=None, progress=False)
        if swept.failures:
            raise ConnectionError(f"runs of {peer.experiment} failed: {as_text(swept.failures)}")
        for metric in peer.metrics:
            yield from measurements(peer, metric, swept.rows)


def measurements(peer: Peer, metric: str, rows: Sequence[Row]) -> Iterator[Measurement]:
    """Compare a metric of each variant with that of the baseline's runs with otherwise equal settings.

    Runs that lack the metric, or whose counterpart lacks it, do not count; the name tells how many of the runs count if
    not all do. Variants without any such run are left out. There is no ratio to a baseline that is 0.
    """
    values = {key_of(row[PLACE]): metric_value(row, metric) for row in rows}
    for variant in dict.fromkeys(row[PLACE][VARIANT] for row in rows):
        places = [row[PLACE] for row in rows if row[PLACE][VARIANT] == variant]
        pairs = [
            (ours, theirs)
            for place in places
            if (ours := values[key_of(place)]) is not None
            and (theirs := values.get(key_of(place | {VARIANT: peer.baseline}))) is not None
        ]
        if not pairs:
            continue
        counted = "" if len(pairs) == len(places) else f" ({len(pairs)} of {len(places)} runs)"
        name = f"{peer.name}: {metric}, {variant}{counted}"
        ours_of_pairs, theirs_of_pairs = map(list, zip(*pairs, strict=True))
        if variant == peer.baseline or not all(theirs_of_pairs):
            yield Measurement(name, unit(metric), median(ours_of_pairs))
        else:
            yield compare(name, unit(metric), ours_of_pairs, peer.baseline, theirs_of_pairs)
