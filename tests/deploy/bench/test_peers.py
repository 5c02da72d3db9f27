"""Peers: their experiments run, and their metrics are compared with a baseline on the same maps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from deploy.bench import peers, registry
from deploy.bench.measurement import Measurement
from deploy.bench.peers import PEERS, Peer, measurements
from deploy.scenario import plan as plans
from deploy.study import experiment as experiments
from deploy.study.measures import exploration
from deploy.study.runs import cases

SIMULATORS = [peer for peer in PEERS if peer.name != "slam_toolbox"]

SMALL = {
    "map": "office", "map_options": {"width_m": 10.0, "height_m": 10.0}, "seed": 0, "robots": 2, "steps": 400,
    "speed": 1.0,
}  # fmt: skip
"""A map on which a run takes less than a second."""


def row(variant: str, seed: int, **metrics: Any) -> dict[str, Any]:
    return {"place": {"variant": variant, "seed": seed}, **metrics}


ROWS = [
    row("nearest", 0, t99=40, overlap_sum=0.0),
    row("nearest", 1, t99=100, overlap_sum=0.0),
    row("repairmen", 0, t99=30, overlap_sum=0.2),
    row("repairmen", 1, t99=50, overlap_sum=0.4),
    row("meier", 0, t99=20, overlap_sum=0.0),
    row("meier", 1, t99=None, overlap_sum=0.0),
    row("greedy", 0, t99=None, overlap_sum=0.0),
]
"""Runs by hand; two have not reached 99 %."""


def test_each_variant_is_compared_with_the_baseline_of_the_same_seed() -> None:
    nearest, repairmen, meier = measurements(Peer("Peer", "", ("t99",)), "t99", ROWS)
    assert nearest == Measurement("Peer: t99, nearest", "steps", 70.0)
    assert (repairmen.name, repairmen.value, repairmen.ratio) == ("Peer: t99, repairmen", 40.0, 0.625)
    assert repairmen.baseline == "nearest"
    assert repairmen.interval == (0.5, 0.75)
    assert (meier.name, meier.value, meier.ratio) == ("Peer: t99, meier (1 of 2 runs)", 20.0, 0.5)


def test_there_is_no_ratio_to_a_baseline_of_zero() -> None:
    found = {each.name: each for each in measurements(Peer("Peer", "", ()), "overlap_sum", ROWS)}
    repairmen = found["Peer: overlap_sum, repairmen"]
    assert (repairmen.value, repairmen.ratio) == (pytest.approx(0.3), None)


@pytest.mark.parametrize("peer", SIMULATORS, ids=lambda peer: peer.name)
def test_the_rules_of_a_peer_make_runs_with_its_metrics(peer: Peer) -> None:
    experiment = experiments.quickened(experiments.read(Path(peer.experiment)))
    chosen = experiments.choose(experiment, ["nearest", "repairmen"])
    rows = [
        exploration(plans.make(case.scenario)) | {"place": case.place}
        for case in cases(experiments.override(chosen, SMALL))
    ]
    for metric in peer.metrics:
        nearest, repairmen = measurements(peer, metric, rows)
        assert nearest.value > 0 or metric == "overlap_sum"
        assert repairmen.unit == nearest.unit
        assert repairmen.baseline == "nearest"
        assert repairmen.ratio == pytest.approx(repairmen.value / nearest.value)


def test_settings_without_a_valid_map_are_rejected_before_the_first_run() -> None:
    tiny = {"map": [{"map": "caves", "map_options": {"width_m": 1.0}}], "seed": [0]}
    with pytest.raises(ValueError, match="width_m"):
        list(peers.peers([Peer("MAES", "peer-maes.toml", ("t90",), settings=tiny)]))


def test_peers_run_only_if_they_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def one(name: str) -> Any:
        return lambda: iter([Measurement(name, "s", 1.0)])

    monkeypatch.setattr(registry, "BENCHMARKS", {"small": one("small"), "peers": one("peers")})
    assert [each["bench"] for each in registry.run_benchmarks([], lambda _: None)] == ["small"]
    assert [each["bench"] for each in registry.run_benchmarks(["peers"], lambda _: None)] == ["peers"]


@pytest.mark.long
def test_repairmen_drives_less_than_to_the_nearest_frontiers_by_the_rules_of_dars() -> None:
    ratios = {each.name: each.ratio for each in peers.peers(PEERS[:1])}
    ratio = ratios["DARS 2024: longest_path_95, repairmen"]
    assert ratio is not None
    assert ratio < 0.85
