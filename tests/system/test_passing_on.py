"""Of A, B and C only A hears B, which is then killed: what was passed on is not lost with it (thesis, 5.1.2)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from deploy.scenario.plan import make
from deploy.scenario.scenario import load
from deploy.study.recovery import recovery


def line(exchange: str, *, pass_on: bool) -> dict[str, Any]:
    return recovery(
        make(
            load(
                Path("line.toml"),
                {"exchange": exchange, "offers": "backoff", "pass_on": pass_on, "bus": "memory"},
            )
        )
    )


@pytest.mark.parametrize("exchange", ["polygon", "sight"])
def test_without_passing_on_b_s_part_is_explored_again_and_with_it_it_is_not(exchange: str) -> None:
    lost, kept = line(exchange, pass_on=False), line(exchange, pass_on=True)
    assert lost["recovery.alone"] == kept["recovery.alone"] > 1000
    assert lost["recovery.again"] > 0.9 * lost["recovery.alone"]
    assert kept["recovery.again"] < 0.05 * kept["recovery.alone"]
    assert kept["recovery.end"] < lost["recovery.end"]
