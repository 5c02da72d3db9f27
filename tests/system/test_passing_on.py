"""Of A, B and C only A hears B, which is then killed: what was passed on is not lost with it (thesis, 5.1.2)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from deploy.scenario.plan import make
from deploy.scenario.scenario import load
from deploy.study.recovery import recovery


def line(map_encoding: str, *, forward_maps: bool) -> dict[str, Any]:
    return recovery(
        make(
            load(
                Path("line.toml"),
                {
                    "map_encoding": map_encoding,
                    "dissemination": "backoff",
                    "forward_maps": forward_maps,
                    "bus": "memory",
                },
            )
        )
    )


@pytest.mark.parametrize("map_encoding", ["polygons", "predictive"])
def test_without_passing_on_b_s_part_is_explored_again_and_with_it_it_is_not(map_encoding: str) -> None:
    lost, kept = line(map_encoding, forward_maps=False), line(map_encoding, forward_maps=True)
    assert lost["recovery.exclusive"] == kept["recovery.exclusive"] > 1000
    assert lost["recovery.reexplored"] > 0.9 * lost["recovery.exclusive"]
    assert kept["recovery.reexplored"] < 0.05 * kept["recovery.exclusive"]
    assert kept["recovery.end"] < lost["recovery.end"]
