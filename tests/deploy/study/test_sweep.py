"""Sweeps, comparisons and sizings from Python."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import murmur
from deploy.record.columns import RECORDED
from deploy.scenario.errors import ScenarioError
from deploy.study import labels
from murmur import RunFailed, Scenario, compare, size, sweep
from tests.deploy.study.small_experiment import EXPERIMENT, write
from tests.worldsim.recorded.made_logs import write_carmen
from worldsim import generators, maps

ROOMS: dict[str, Any] = {
    "map": "leader-rooms", "robots": 3, "sensor_range": 2.5, "speed": 1.0, "map_encoding": "scans",
    "bandwidth": "unlimited", "strategy": "leaders",
}  # fmt: skip
QUIET: dict[str, Any] = {"progress": False, "jobs": 1}


def test_a_sweep_runs_each_value_of_a_list(tmp_path: Path) -> None:
    out = tmp_path / "runs.parquet"
    done = sweep(map="em", steps=[2, 3], seed=range(2), robots=1, out=out, **QUIET)
    assert done.runs.select("steps", "seed").rows() == [(2, 0), (2, 1), (3, 0), (3, 1)]
    assert len(pl.read_parquet(out)) == 4 and len(done.table) == 6
    assert repr(done) == "<Sweep sweep: 4 of 4 runs>" and "<table" in done._repr_html_()


def test_maps_of_one_name_in_several_folders_are_told_apart(tmp_path: Path) -> None:
    files = [tmp_path / site / "map.yaml" for site in ("north", "south")]
    for width, file in zip((12, 14), files, strict=True):
        file.parent.mkdir()
        maps.save(generators.make("office", width_m=width, height_m=12), file)
    done = sweep(map=files, steps=2, seed=[0, 1], robots=1, metrics=["steps"], **QUIET)
    assert done.table.select("map", "runs").rows() == [(str(file), 2) for file in files]
    assert done.runs["map"].unique(maintain_order=True).to_list() == list(map(str, files))
    compared = compare([{"strategy": "nearest"}, {"strategy": "meier"}], map=files, steps=2, seeds=2, **QUIET)
    titles = [panel.get_title() for panel in compared.plot().axes]
    assert [title.replace("\n", "") for title in titles] == [f"map {file}" for file in files]


def test_a_picture_is_a_map_of_each_resolution(tmp_path: Path) -> None:
    maps.save(generators.make("office", width_m=12, height_m=12), tmp_path / "plan.yaml")
    resolutions = {"map_options.resolution": [0.05, 0.1]}
    done = sweep(map=tmp_path / "plan.png", steps=2, seed=0, robots=1, **resolutions, **QUIET)
    half, whole = done.runs["range_m"]
    assert whole == pytest.approx(2 * half)


def test_numbers_and_lists_of_numpy_and_polars_are_those_of_python(tmp_path: Path) -> None:
    out = str(tmp_path / "new" / "runs.parquet")
    done = sweep(map="em", steps=np.array([2, 3]), seed=pl.Series([0]), robots=np.int64(1), out=out, **QUIET)
    assert done.runs.select("steps", "robots").rows() == [(2, 1), (3, 1)]
    assert len(pl.read_parquet(out)) == 2
    assert Scenario(robots=np.int32(2), start=np.array([1.0, 2.0])).start == (1.0, 2.0)
    tried = {"bandwidth": np.array([100]), "range": ("100%",), "seeds": np.int64(1), "out": out}
    assert len(size("em", robots=np.arange(1, 2), steps=2, **tried, **QUIET).options) == 1


@pytest.mark.parametrize(
    ("tried", "message"),
    [
        ({"bandwidth": 100}, r"bandwidth = 100: must be a list of values, as \[100\]"),
        ({"range": "30%"}, r"range = '30%': must be a list of values, as \['30%'\]"),
        ({"robots": []}, r"robots = \[\]: is an empty list; give at least one value"),
        ({"seeds": 0}, "seeds = 0: must be a whole number from 1 to 100000"),
        ({"seeds": 2.5}, r"seeds = 2\.5: must be a whole number"),
        ({"deadline": -1}, "deadline = -1: must be a number of steps, at least 1"),
        ({"min_map_accuracy": 95}, "min_map_accuracy = 95: must be a share from 0 to 1, as 0.95"),
    ],
)
def test_sizings_of_no_meaning_are_rejected_before_their_runs(
    tmp_path: Path, tried: dict[str, Any], message: str
) -> None:
    out = tmp_path / "runs.parquet"
    with pytest.raises(ScenarioError, match=message):
        size("em", out=out, **tried, **QUIET)
    assert not out.exists()


def test_an_experiment_is_swept_with_other_settings(tmp_path: Path) -> None:
    plot = '[[plot]]\nx = "robots"\ny = "steps"\nfinished_only = false\n'
    done = sweep(write(tmp_path, EXPERIMENT + plot), seed=0, robots=[1], **QUIET)
    assert done.runs["variant"].to_list() == ["polygons", "scans"]
    assert len(done.plot().axes) == 1
    with pytest.raises(ValueError, match="there is no plot 1: the experiment has 1"):
        done.plot(1)
    with pytest.raises(ScenarioError, match="only without an experiment"):
        sweep("lossy.toml", base={"robots": 3})


def test_a_plot_has_the_runs_that_where_selects(tmp_path: Path) -> None:
    plot = '[[plot]]\nx = "robots"\ny = "steps"\nfinished_only = false\npanels = "robots"\nwhere = {{ {} }}\n'
    one = write(tmp_path, EXPERIMENT + plot.format("robots = [2]"))
    done = sweep(one, seed=0, robots=[1, 2, 3], **QUIET)
    assert [axes.get_title() for axes in done.plot().axes] == ["robots 2"]
    none = write(tmp_path, EXPERIMENT + plot.format("robots = [5]"))
    assert len(sweep(none, seed=0, robots=[1], **QUIET).plot().axes) == 1
    with pytest.raises(
        ScenarioError, match=r"plot.where names 'speed', which is not in the grid; there are: .*robots"
    ):
        sweep(write(tmp_path, EXPERIMENT + plot.format("speed = [1.0]")), **QUIET)


def test_variants_are_run_on_the_same_grid() -> None:
    variants = {"near": {"sensor_range": 2.0}, "far": {"sensor_range": 5.0}}
    done = sweep(base={"map": "em", "steps": 2}, variants=variants, robots=[1], **QUIET)
    assert done.runs.select("variant", "sensor_range").rows() == [("near", 2.0), ("far", 5.0)]


def test_scenarios_are_compared_in_pairs_with_a_verdict_and_pictures(tmp_path: Path) -> None:
    done = compare([ROOMS, ROOMS | {"speed": 0.3}], seeds=4, **QUIET)
    (sentence,) = done.verdicts
    assert sentence.startswith("speed 1.0 has less than speed 0.3: 0.")
    assert " times the steps of " in sentence and sentence.endswith("4 pairs)")
    assert done.table.filter(pl.col("metric") == "steps")["variant"].to_list() == ["speed 1.0", "speed 0.3"]
    for file in done.write(tmp_path):
        assert file.stat().st_size > 100
    assert done._repr_html_().count("<img") == 2


def test_small_ratios_have_two_significant_digits() -> None:
    done = compare(
        [ROOMS | {"map_encoding": each} for each in ("predictive", "scans")],
        seeds=2,
        metric="bytes.total",
        **QUIET,
    )
    ratio = r"0\.0[0-9]*[1-9]"
    assert re.search(rf": {ratio} \[{ratio}, {ratio}\] times the bytes\.total of scans", done.verdicts[0])


def test_noisy_maps_are_compared_by_their_walls_and_their_agreement() -> None:
    small = {
        "map": "office",
        "map_options": {"width_m": 12.0, "height_m": 10.0},
        "robots": 2,
        "bandwidth": 12,
    }
    noisy = {laser: small | {"laser": {"preset": laser}} for laser in ("sick-lms", "rplidar-a1")}
    done = compare(noisy, seeds=2, metric="worst_walls_within_tolerance", **QUIET)
    assert " times the worst_walls_within_tolerance of " in done.verdicts[0]
    means = dict(done.table.filter(pl.col("n") == 2).group_by("metric").agg(pl.col("mean").min()).rows())
    assert 0 < means["worst_walls_within_tolerance"] < means["walls_within_tolerance"] < 1
    assert 0.9 < means["claimed_worst_wall_f1"] < 1


@pytest.mark.parametrize(
    ("scenarios", "hint"),
    [
        (
            ["nearest", "greedy"],
            "'nearest': is a strategy, not a scenario's file; use --strategies, or in Python {'str",
        ),
        (
            ["cells", "scans"],
            "'cells': is a map encoding, not a scenario's file; use --map-encodings, or in Python",
        ),
        (
            ["ble", "wifi"],
            "'ble': is a radio preset, not a scenario's file; use --radios, or in Python {'radio': 'ble'}",
        ),
        ("nearest,greedy", "scenarios = 'nearest,greedy': must be a list, or a dict"),
    ],
)
def test_names_in_place_of_scenarios_are_explained(scenarios: Any, hint: str) -> None:
    with pytest.raises(ScenarioError, match=re.escape(hint)):
        compare(scenarios, seeds=2, **QUIET)


def test_scenarios_of_files_and_objects_are_compared_by_their_names(tmp_path: Path) -> None:
    (tmp_path / "slow.toml").write_text('map = "em"\nspeed = 0.2\nsteps = 3\n')
    (tmp_path / "fast.toml").write_text('map = "em"\nspeed = 1.0\nsteps = 3\n')
    done = compare([tmp_path / "slow.toml", tmp_path / "fast.toml"], seeds=2, robots=1, **QUIET)
    assert done.verdicts == ["slow and fast: no pair of runs to compare (2 excluded as unfinished or 0)"]
    objects = [Scenario(map="em", steps=2, robots=1, map_encoding=name) for name in ("none", "predictive")]
    assert "none and predictive" in compare(objects, seeds=2, **QUIET).verdicts[0]


def test_recorded_runs_are_compared_by_the_keys_that_only_they_have(tmp_path: Path) -> None:
    log = str(write_carmen(tmp_path / "room.log", scans=4))
    common: dict[str, Any] = {"recording": {"files": [log]}, "robots": 2}
    sides = {name: {"map_encoding": name} for name in ("predictive", "scans")}
    done = compare(sides, seeds=2, metric="bytes_per_scan", **common, **QUIET)
    assert [row["bytes_per_scan"] == row["bytes.total"] / row["scans"] for row in done.sweep.rows] == 4 * [
        True
    ]
    assert "times the bytes_per_scan of scans" in done.verdicts[0]
    for name in ", ".join(RECORDED).split(", "):
        assert name == "logs" or labels.unit(name), name


@pytest.mark.parametrize(
    ("scenarios", "settings", "message"),
    [
        ([ROOMS], {}, "nothing to compare"),
        ([ROOMS, {**ROOMS, "speed": 2.0}], {"seeds": 1}, "seeds = 1: must be a whole number from 2"),
        ([ROOMS, ROOMS], {}, "two of the scenarios are the same: map = "),
        ({"a": ROOMS, "b": ROOMS}, {}, "two of the scenarios are the same"),
        ([ROOMS, ROOMS | {"robots": 0}], {}, "robots = 0"),
        ([ROOMS | {"strategy": "meier"}, ROOMS | {"strategi": "meier"}], {}, "strategi: unknown setting"),
        ([ROOMS, ROOMS | {"speed": 2.0}], {"metric": "stepz"}, "'stepz' is not a metric"),
    ],
)
def test_invalid_comparisons_are_rejected(scenarios: Any, settings: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        compare(scenarios, **settings, **QUIET)


def fail(out: Path, **settings: object) -> None:
    """Let runs of a table with these settings fail."""
    chosen = pl.all_horizontal(pl.col(name) == value for name, value in settings.items())
    spoilt = pl.when(chosen).then(pl.lit("it broke")).otherwise(pl.col("error")).alias("error")
    pl.read_parquet(out).with_columns(spoilt).write_parquet(out)


def test_studies_without_a_successful_run_raise_with_the_causes(tmp_path: Path) -> None:
    out = tmp_path / "runs.parquet"
    sides = [{"map": "em", "steps": 2, "robots": 1, "map_encoding": name} for name in ("none", "predictive")]
    assert "none and predictive" in compare(sides, seeds=2, out=out, **QUIET).verdicts[0]
    fail(out, map_encoding="none", seed=0)
    assert len(compare(sides, seeds=2, out=out, **QUIET).sweep.rows) == 3
    fail(out, map_encoding="none")
    with pytest.raises(RunFailed, match=r"^none: all runs failed: it broke \(2 runs\)$"):
        compare(sides, seeds=2, out=out, **QUIET)
    with pytest.raises(RunFailed, match=r"^all runs failed: it broke \(2 runs\)$"):
        sweep(base=sides[0], seed=[0, 1], out=out, **QUIET)
    assert len(sweep(base=sides[0], seed=[0, 1], out=out, retry=True, **QUIET).rows) == 2


def test_the_smallest_sufficient_team_is_named(tmp_path: Path) -> None:
    settings = {name: value for name, value in ROOMS.items() if name not in ("map", "robots", "bandwidth")}
    tried = {"robots": [3, 1], "bandwidth": ["unlimited", 100], "range": ["100%"], "seeds": 2, "steps": 200}
    out = tmp_path / "runs.parquet"
    done = size("leader-rooms", deadline=45, out=out, **tried, **settings, **QUIET)
    assert [(o.robots, o.bandwidth) for o in done.options] == [
        (1, 100),
        (1, "unlimited"),
        (3, 100),
        (3, "unlimited"),
    ]
    assert done.enough is not None and done.enough.robots == 3
    assert (
        done.sentence.startswith("3 robots with ")
        and "2 of 2 runs (at least 34 % of all runs" in done.sentence
    )
    assert re.search(r": in \d+ ± \d+ steps, 2 of 2 runs", done.sentence)
    assert [file.name for file in done.write(tmp_path)] == ["size.png", "size.csv"]
    assert [text.get_text() for panel in done.plot().axes for text in panel.texts] == ["deadline"]
    assert "<img" in done._repr_html_()
    never = size("leader-rooms", deadline=3, out=out, **tried, **settings, **QUIET)
    assert never.enough is None and never.sentence.startswith(
        "None of these teams always explores leader-rooms"
    )
    fail(out, robots=3, seed=1)
    broken = size("leader-rooms", deadline=45, out=out, **tried, **settings, **QUIET)
    assert broken.enough is None and ": 1 of 2 runs, in " in broken.sentence


def test_all_robots_must_finish_with_an_accurate_map_unless_the_first_is_enough(tmp_path: Path) -> None:
    alone = {
        "strategy": "meier", "map_encoding": "none", "sensor_range": 3.0,
        "map_options": {"width_m": 10.0, "height_m": 10.0},
    }  # fmt: skip
    tried = {"robots": [2], "bandwidth": [100], "range": ["100%"], "seeds": 1, "out": tmp_path / "r.parquet"}
    first, each = (size("office", finish=finish, **tried, **alone, **QUIET) for finish in ("first", "all"))
    assert first.options[0].steps.mean < each.options[0].steps.mean
    assert first.enough is not None and "95 % of the first robot's map correct" in first.sentence
    assert each.enough is not None and "95 % of each robot's map correct" in each.sentence
    poor = pl.read_parquet(tried["out"]).with_columns(pl.lit(0.9).alias("worst_map_accuracy"))
    poor.write_parquet(tried["out"])
    first, each = (size("office", finish=finish, **tried, **alone, **QUIET) for finish in ("first", "all"))
    assert first.enough is not None
    assert each.enough is None
    assert each.sentence.endswith("; its worst map is 90.0 % correct.")


def test_the_shortest_range_of_a_finished_run_is_named() -> None:
    settings = {name: value for name, value in ROOMS.items() if name not in ("map", "robots", "bandwidth")}
    tried = {"robots": [1, 3], "bandwidth": ["unlimited"], "range": ["100%", "9"], "seeds": 1, "steps": 36}
    done = size("leader-rooms", deadline=3, **tried, **settings, **QUIET)
    assert [(o.robots, o.range, o.steps.n) for o in done.options] == [
        (1, "9", 0),
        (1, "100%", 0),
        (3, "9", 1),
        (3, "100%", 1),
    ]
    assert "the best has 3 robots with unlimited bandwidth and a range of " in done.sentence
    assert [str(o).rpartition(" of ")[2] for o in done.options[:2]] == ["9 m", "100%"]
    assert {panel.get_title() for panel in done.plot().axes} == {"range 9 m", "range 100%"}


def test_the_whole_module_is_exported() -> None:
    assert {"compare", "explore", "size", "sweep"} <= set(murmur.__all__)
