"""Murmur from Python: short words to run it, short words about what came out, frames, maps and pictures."""

from __future__ import annotations

import multiprocessing
import pydoc
import re
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas
import polars
import pytest

import murmur
from deploy.record.columns import LEDGER, STEPS
from deploy.scenario.errors import ScenarioError
from murmur import Result, Scenario, explore, read_run
from protocol.grid import FREE
from protocol.presets import PRESETS

SMALL = {"map": "em", "robots": 2, "bus": "memory", "steps": 12}


@cache
def small() -> Result:
    return explore(keep=False, **SMALL)


def test_settings_may_be_named_in_the_call() -> None:
    assert small().summary["digest"] == explore(Scenario(**SMALL), keep=False).summary["digest"]
    other = explore(Scenario(**SMALL), keep=False, robots=1, seed=3)
    assert (other.summary["robots"], other.summary["seed"], other.summary["map"]) == (1, 3, "em")


@pytest.mark.parametrize("call", [lambda: Scenario(rnge=1), lambda: explore(rnge=1)])  # type: ignore[call-arg]
def test_a_setting_that_there_is_not_is_named_with_the_one_that_was_meant(call: object) -> None:
    with pytest.raises(
        ScenarioError, match=r"rnge: unknown setting; did you mean range or change\? There are: map,"
    ):
        call()  # type: ignore[operator]


def test_all_that_is_wrong_is_named() -> None:
    with pytest.raises(ScenarioError) as caught:
        Scenario(robots=0, speed=-1)
    assert [line.split(" = ")[0] for line in str(caught.value).splitlines()] == ["robots", "speed"]


def test_a_result_is_told_in_a_line() -> None:
    said = repr(small())
    assert len(said) < 200
    assert said.startswith("<Result: 2 robots on em, out of steps after 12 steps, coverage 0.")
    assert len(repr(small().records)) < 80


def test_a_notebook_shows_maps_and_figures() -> None:
    class Page(HTMLParser):
        def __init__(self) -> None:
            super().__init__()
            self.pictures: list[str] = []
            self.cells: list[str] = []

        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            if tag == "img":
                self.pictures.append(str(dict(attrs)["src"]))

        def handle_data(self, data: str) -> None:
            self.cells.append(data)

    page = Page()
    page.feed(small()._repr_html_())
    (picture,) = page.pictures
    assert picture.startswith("data:image/png;base64,")
    assert {"steps", "12", "digest", str(small().summary["digest"])} <= set(page.cells)


def test_steps_and_ledger_are_frames_that_agree_with_the_summary() -> None:
    steps, ledger = small().steps, small().ledger
    assert isinstance(steps, polars.DataFrame) and isinstance(ledger, polars.DataFrame)
    assert steps.height == 2 * 12 and steps["step"].max() == 12
    carried = ledger.filter(polars.col("carried"))["bytes"].sum()
    assert carried == small().summary["bytes"]["total"]


def test_pandas_frames_have_the_rows_and_columns_of_the_tables() -> None:
    tables = small().to_pandas()
    assert list(tables) == ["steps", "ledger"]
    assert all(isinstance(table, pandas.DataFrame) for table in tables.values())
    assert list(tables["steps"].columns) == [column.name for column in STEPS]
    assert list(tables["ledger"].columns) == [column.name for column in LEDGER]
    driven = tables["steps"].groupby("robot")["driven"].max()
    assert driven.round(3).tolist() == small().summary["path_length"]
    ledger = tables["ledger"]
    assert ledger[ledger["carried"]]["bytes"].sum() == small().summary["bytes"]["total"]


def test_a_run_directory_gives_the_frames_of_its_result(tmp_path: Path) -> None:
    result = explore(out=tmp_path / "run", **SMALL)  # type: ignore[arg-type]
    run = read_run(tmp_path / "run")
    assert repr(run) == f"<RecordedRun: 2 robots on em, in {tmp_path / 'run'}>"
    assert run.summary["digest"] == result.summary["digest"]
    assert run.steps.drop("work_us").equals(result.steps.drop("work_us"))
    assert run.ledger.equals(result.ledger)
    assert list(run.maps) == list(result.maps)
    assert all((run.maps[name] == grid).all() for name, grid in result.maps.items())
    for name, table in run.to_pandas().items():
        pandas.testing.assert_frame_equal(table, result.to_pandas()[name])
    with pytest.raises(ScenarioError, match=r"not a run directory: scenario\.toml is missing"):
        read_run(str(tmp_path))


def test_without_pandas_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(ImportError, match=r"pip install 'murmur-robots\[pandas\]'"):
        small().to_pandas()


def test_maps_are_grids_by_name_and_robot() -> None:
    maps = small().maps
    assert list(maps) == ["truth", "team", 0, 1]
    assert len({grid.shape for grid in maps.values()}) == 1
    seen = (maps["team"] == FREE) & (maps["truth"] == FREE)
    assert np.count_nonzero(seen) == np.count_nonzero(maps["team"] == FREE) > 0


def test_each_public_name_exists_and_is_documented() -> None:
    for name in murmur.__all__:
        assert getattr(murmur, name).__doc__, name


def test_the_import_loads_nothing_that_the_program_does_not_use() -> None:
    loaded = "import sys, murmur; print('numba' in sys.modules, 'matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]


def test_a_typing_error_in_a_name_of_the_package_is_one() -> None:
    with pytest.raises(AttributeError, match="exlpore"):
        murmur.exlpore  # noqa: B018


@pytest.mark.parametrize("given", ["office", {"robots": 3}, 3])
def test_what_is_no_scenario_is_told_how_settings_are_given(given: object) -> None:
    for call in (explore, murmur.steps):
        with pytest.raises(
            TypeError, match=r"must be a Scenario; settings are given by name, as in explore\(map="
        ):
            call(given)  # type: ignore[operator]


def test_a_directory_may_be_text_and_is_refused_where_nothing_is_kept(tmp_path: Path) -> None:
    assert explore(out=str(tmp_path / "run"), **SMALL).directory == tmp_path / "run"  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="keep = False writes no directory"):
        explore(out="run", keep=False, **SMALL)  # type: ignore[arg-type]


def test_a_file_of_a_strategy_is_told_how_its_class_is_named() -> None:
    with pytest.raises(
        ScenarioError, match=r"farthest\.py is a file: give the strategy in it as farthest:Class"
    ):
        Scenario(strategy="farthest.py")
    with pytest.raises(ScenarioError, match=r"give the module without \.py, as farthest:Farthest"):
        Scenario(strategy="farthest.py:Farthest")


def test_help_and_completion_have_the_public_names_only() -> None:
    assert dir(murmur) == sorted(murmur.__all__)
    page = pydoc.plain(pydoc.render_doc(murmur))
    assert {"explore", "sweep", "read_run"} <= set(re.findall(r"^    (\w+)\(", page, re.M))


def test_a_scenario_file_is_named_by_text_or_path() -> None:
    assert murmur.load("office.toml") == murmur.load(Path("office.toml"), {"robots": None})
    assert murmur.load("office.toml", {"radio.loss": 0.1, "robots": 2}).robots == 2
    for file in ("office.toml", Path("office.toml")):
        plan = murmur.steps(file, **{"radio.loss": 0.1}).plan
        assert plan.scenario == murmur.load(file, {"radio.loss": 0.1, "bus": "memory"})


def test_settings_have_the_names_and_the_effect_that_they_have_on_the_command_line() -> None:
    late = Scenario(radio={"delay": 2}, start_spacing=0.2, **SMALL)
    lossy = explore(late, keep=False, **{"radio.loss": 0.1}).plan.scenario
    assert (lossy.radio.delay, lossy.radio.loss, lossy.start_spacing) == (2, 0.1, 0.2)
    other = explore(Scenario(radio="lora-sf9", **SMALL), keep=False, radio="wifi").plan.scenario
    assert (other.bandwidth, other.radio.frame_bytes) == (PRESETS["wifi"].bandwidth, 1500)
    thesis = explore(map_encoding="scans", thesis=True, keep=False, **SMALL).plan.scenario
    assert (thesis.map_encoding, thesis.dissemination, thesis.strategy) == ("scans", "thesis", "meier")
    assert thesis.options == {"herding": False}
    with pytest.raises(ScenarioError, match=r"radio\.lost: unknown|radio = .*lost"):
        murmur.steps(**{"radio.lost": 0.1})


def test_a_map_may_be_a_path(tmp_path: Path) -> None:
    assert Scenario(map=tmp_path / "hall.yaml").map == str(tmp_path / "hall.yaml")


def test_in_a_worker_that_may_not_start_processes_the_error_names_what_can(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)  # type: ignore[attr-defined]
    for call in (
        lambda: explore(map="em", steps=2, out=tmp_path / "run"),
        lambda: murmur.sweep(map="em", steps=2, seed=[0], progress=False),
    ):
        with pytest.raises(
            ValueError, match=r"a worker of multiprocessing\.Pool .*ProcessPoolExecutor with .*spawn"
        ):
            call()
    assert not (tmp_path / "run").exists()
    assert explore(keep=False, **SMALL).summary["digest"] == small().summary["digest"]


@pytest.mark.slow
def test_in_a_process_forked_after_a_run_with_processes_the_error_names_what_can() -> None:
    script = """
import os, murmur
size = {"map": "em", "robots": 1, "steps": 2, "keep": False}
murmur.explore(**size)
if os.fork():
    os.wait()
else:
    print(murmur.explore(bus="memory", **size).exit_code)
    try:
        murmur.explore(**size)
    except ValueError as error:
        print(error)
    os._exit(0)
"""
    done = subprocess.run([sys.executable, "-uc", script], capture_output=True, text=True, check=True)
    code, error = done.stdout.splitlines()
    assert code == "1"
    assert error.startswith("this process was forked from one in which runs had processes")


@pytest.mark.parametrize(
    ("call", "problem"),
    [
        (lambda: murmur.compare("office.toml"), "must be a list, or a dict"),
        (
            lambda: murmur.compare([{"seed": 0}, {"robots": 2}], jobs=0),
            "jobs = 0: must be a number of processes",
        ),
        (lambda: murmur.sweep(seed=[0], metrics="steps"), r"metrics = 'steps': must be a list of values"),
        (lambda: murmur.sweep(seed=[0], metrics=["step"]), "'step' is not a metric"),
        (lambda: murmur.sweep(seed=[0], out="runs.csv"), r"out = 'runs\.csv': .*must end in \.parquet"),
        (lambda: murmur.size("em", radio=["wifi", "ble"]), "size_radios tests several radios"),
        (lambda: murmur.explore(hosts="elsewhere.toml"), "hosts elsewhere.toml: no such file"),
        (lambda: murmur.merge("elsewhere", "team"), "elsewhere is not the record of a robot"),
    ],
)
def test_arguments_without_a_meaning_are_explained_before_any_run(
    call: Callable[[], object], problem: str
) -> None:
    with pytest.raises(ValueError, match=problem):
        call()
