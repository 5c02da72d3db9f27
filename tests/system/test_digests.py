"""The backbone: a run gives the same digest as processes on Zenoh and in one process in memory."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from agent.encoding_options import THESIS_OPTIONS
from deploy.run import exploration
from deploy.scenario.scenario import parse
from tests.agent.encodings.names import EXACT
from worldsim import generators, maps

BUSY_S = 60
"""Seconds after which a process that keeps a core busy ends."""


@pytest.fixture(scope="module")
def floor(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A map of 120 x 120 cells, in a file."""
    path = tmp_path_factory.mktemp("map") / "office.yaml"
    maps.save(generators.make("office", width_m=12, height_m=12), path)
    return str(path)


def explore(bus: str, **settings: Any) -> dict[str, Any]:
    """Run a scenario; return its summary."""
    result = exploration.explore(parse({"bus": bus, "sensor_range": 3.0} | settings), keep=False)
    assert not result.deaths
    assert not result.records.lost
    return result.summary


def check_both_buses(**settings: Any) -> None:
    """Run a scenario on both buses; whatever is a result must be the same."""
    memory, zenoh = (explore(bus, **settings) for bus in ("memory", "zenoh"))
    assert zenoh["digest"] == memory["digest"]
    for name in ("steps", "first_robot", "coverage", "map_accuracy", "path_length", "bytes", "undelivered"):
        assert zenoh[name] == memory[name], name


QUICK = [
    {"map_encoding": "polygons", "robots": 3, "bandwidth": 1000},
    {"map_encoding": "polygons", "robots": 8, "bandwidth": 150, "range": "30%"},
    {"map_encoding": "polygons", "robots": 5, "bandwidth": "unlimited", "dissemination": "thesis"},
    {"map_encoding": "scans", "robots": 2, "bandwidth": "unlimited", "range": 4},
    {"map_encoding": "none", "robots": 2, "range": "20%"},
    {"map_encoding": "predictive", "robots": 5, "bandwidth": 50, "dissemination": "gossip"},
    {
        "map_encoding": "predictive",
        "robots": 4,
        "bandwidth": "unlimited",
        "range": "30%",
        "dissemination": "gossip",
    },
    {"map_encoding": "predictive", "robots": 3, "bandwidth": 200},
    {"map_encoding": "cells", "robots": 3, "bandwidth": 300, "dissemination": "gossip"},
]
MORE = [
    {"map_encoding": "scans", "robots": 5, "bandwidth": 1000},
    {"map_encoding": "cells", "robots": 3, "bandwidth": 1000},
    {"map_encoding": "polygons", "robots": 3, "bandwidth": 500, "range": 5, "dissemination": "gossip"},
    {"map_encoding": "scans", "robots": 3, "bandwidth": "unlimited", "range": 5, "dissemination": "gossip"},
    {"map_encoding": "polygons", "robots": 1},
]
CASES = [*QUICK, *(pytest.param(case, marks=pytest.mark.long) for case in MORE)]


@pytest.mark.parametrize("settings", CASES, ids=lambda case: "-".join(str(value) for value in case.values()))
def test_the_digest_is_the_same_on_both_buses(floor: str, settings: dict[str, Any]) -> None:
    polygons = asdict(THESIS_OPTIONS) if settings.get("dissemination") == "thesis" else {}
    check_both_buses(map=floor, steps=40, seed=7, polygons=polygons, **settings)


@contextmanager
def busy_machine(processes: int) -> Iterator[None]:
    """Keep cores busy for a while."""
    count = f"import time\nend = time.monotonic() + {BUSY_S}\nwhile time.monotonic() < end: pass"
    crowd = [subprocess.Popen([sys.executable, "-c", count]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in crowd:
            process.kill()
            process.wait()


def test_the_digest_does_not_depend_on_how_busy_the_machine_is(floor: str) -> None:
    settings = {"map": floor, "robots": 4, "bandwidth": 300, "range": "50%", "steps": 30, "seed": 3}
    quiet = explore("memory", **settings)
    with busy_machine(3):
        assert explore("zenoh", **settings)["digest"] == quiet["digest"]


def test_another_seed_gives_another_digest(floor: str) -> None:
    digests = {explore("memory", map=floor, steps=10, seed=seed)["digest"] for seed in range(3)}
    assert len(digests) == 3


@pytest.mark.long
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(
    ("map_encoding", "dissemination", "robots", "bandwidth", "reach"),
    list(product(EXACT, ["backoff", "gossip"], [1, 2, 5, 8], [200, "unlimited"], ["15%", "100%"])),
)
def test_the_digest_is_the_same_on_both_buses_for_every_team(
    floor: str,
    map_encoding: str,
    dissemination: str,
    robots: int,
    bandwidth: int | str,
    reach: str,
    seed: int,
) -> None:
    settings = {
        "map_encoding": map_encoding,
        "dissemination": dissemination,
        "robots": robots,
        "bandwidth": bandwidth,
        "range": reach,
        "seed": seed,
    }
    check_both_buses(map=floor, steps=150, **settings)


@pytest.mark.long
@pytest.mark.parametrize("name", ["intel", "fr079"])
def test_the_digest_is_the_same_on_both_buses_on_real_maps(real_maps: Path, name: str) -> None:
    check_both_buses(map=str(real_maps / f"{name}.yaml"), robots=5, bandwidth=1000, sensor_range=5.0, seed=1)
