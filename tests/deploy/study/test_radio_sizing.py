"""`murmur size --radio`: the smallest team for each radio."""

from __future__ import annotations

import io
import time
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from rich.console import Console

from deploy.scenario.errors import ScenarioError
from deploy.study.progress import counting
from murmur import compare, size_radios, sweep
from protocol.presets import PRESETS

ROOMS: dict[str, Any] = {"sensor_range": 2.5, "speed": 1.0, "strategy": "leaders"}
QUIET: dict[str, Any] = {"progress": False, "jobs": 1}
TRIED: dict[str, Any] = {"robots": [3, 1], "seeds": 2, "jobs": 1, **ROOMS}


def test_teams_grow_until_all_runs_of_a_radio_suffice(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []

    def note(done: int, total: int) -> None:
        seen.append((done, total))

    out = tmp_path / "runs.parquet"
    radios = ["lora-sf12", "wifi"]
    done = size_radios("leader-rooms", radios, deadline=45, out=out, progress=note, **TRIED)
    lora, wifi = done.answers
    assert (wifi.radio, wifi.robots, wifi.tried, wifi.met, wifi.is_enough) == ("wifi", 3, [1, 3], 2, True)
    assert wifi.steps.mean <= 45 and wifi.worst_map is not None and wifi.worst_map >= 0.95
    assert lora.tried == [1, 3]
    assert lora.duty_cycle is not None and 0 < lora.duty_cycle <= PRESETS["lora-sf12"].limit.duty_cycle
    assert (seen[0], seen[-1]) == ((0, 4), (8, 8)), "progress begins before the first run"
    assert done.lines[2][0] == "wifi" and done.lines[2][-1] == "none, ETSI EN 300 328, 2.4 GHz"
    assert done.lines[1][-1] == "1 %, ETSI EN 300 220-2, 868.0 to 868.6 MHz"
    assert "Duty cycles keep the legal limit (lora-sf12); --set radio.duty_cycle=1" in done.sentences[2]
    assert done.sentences[1] == "2 of 2 runs mean at least 34 % of all runs, with 95 % confidence."
    files = done.write(tmp_path)
    assert [file.name for file in files] == ["radios.png", "radios.csv"]
    assert pl.read_csv(files[1])["radio"].to_list() == radios
    small = size_radios(
        "leader-rooms", ["wifi"], deadline=500, out=out, progress=False, **(TRIED | {"seeds": 1})
    )
    assert (small.answers[0].robots, small.answers[0].tried) == (1, [1])
    assert "1 of 1" in small.lines[1]


def test_radios_without_a_sufficient_team_and_without_their_duty_cycle_are_named() -> None:
    settings = {"robots": [1, 2], "seeds": 1, "steps": 4, "radio.duty_cycle": 1, **ROOMS, **QUIET}
    done = size_radios("leader-rooms", ["lora-sf7"], **settings)
    assert done.lines[1][1:4] == ["none of 1 to 2; best 1", "0 of 1", "-"]
    assert done.sentences[-1] == "Duty cycles do not keep the legal limit (lora-sf7)."


@pytest.mark.parametrize(
    ("radios", "message"),
    [
        (["zigbee", "zigby"], "no radio preset is called 'zigby'; did you mean zigbee"),
        (["zigbee", "zigbee"], "contains 'zigbee' twice"),
        ([], "radio = .*: is an empty list; give at least one value"),
    ],
)
def test_invalid_lists_of_radios_are_refused(radios: list[str], message: str) -> None:
    with pytest.raises(ScenarioError if radios != ["zigbee", "zigby"] else ValueError, match=message):
        size_radios("leader-rooms", radios, **QUIET)


def test_radios_are_an_axis_of_sweeps_and_comparisons() -> None:
    settings: dict[str, Any] = {"map": "em", "robots": 2, "steps": 2, **QUIET}
    done = sweep(radio=["zigbee", "lora-sf12"], **settings)
    assert done.runs.select("radio", "bandwidth").rows() == [
        (name, str(PRESETS[name].bandwidth)) for name in ("zigbee", "lora-sf12")
    ]
    both = compare([{"radio": "zigbee"}, {"radio": "wifi"}], seeds=2, metric="coverage", **settings)
    assert set(both.sweep.experiment.variants) == {"zigbee", "wifi"}
    over = compare(
        [{"strategy": "meier"}, {"strategy": "nearest"}], radio=["zigbee", "wifi"], seeds=2, metric="coverage",
        **settings,
    )  # fmt: skip
    assert len(over.sweep.rows) == 8 and set(over.table["radio"]) == {"zigbee", "wifi"}


def test_progress_without_a_terminal_begins_at_once_and_estimates_the_rest() -> None:
    text = io.StringIO()
    with counting(Console(file=text), "size", announce=True) as report:
        assert text.getvalue() == "size: begins\n"
        report(2, 6)
        report(3, 6)
        report(6, 6)
    lines = text.getvalue().splitlines()
    assert lines[1] == "size: 2 of 6"
    assert lines[2].startswith("size: 3 of 6, ") and lines[2].endswith(" s left")
    assert len(lines) == 3


def test_the_start_of_the_programs_does_not_lengthen_the_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter((0.0, 0.0, 10.0, 10.1, 10.2))
    monkeypatch.setattr(time, "monotonic", lambda: next(times))
    text = io.StringIO()
    with counting(Console(file=text), "compare") as report:
        for done in range(4):
            report(done, 100)
    assert text.getvalue().splitlines()[-1] == "compare: 3 of 100, 10 s left"
