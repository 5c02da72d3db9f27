"""Tables of means: figures of summaries, rows and columns, runs compared with another variant's."""

from __future__ import annotations

from typing import Any

import pytest

from deploy.study.tables import (
    METRICS,
    TABLES,
    Table,
    check,
    described,
    has_finished,
    means,
    metric_value,
    tabulate,
)
from tests.deploy.small_run import small_run

VARIANTS = ["polygons", "scans"]


def runs(totals: tuple[int, ...] = (10, 40, 30, 40)) -> list[dict[str, Any]]:
    places = [{"robots": 2, "seed": seed, "variant": name} for seed in (0, 1) for name in VARIANTS]
    return [
        {"place": place, "steps": 5 + place["seed"], "bytes.total": total}
        for place, total in zip(places, totals, strict=False)
    ]


def test_metrics_are_names_sums_and_quotients() -> None:
    summary = {"steps": 4, "t99": None, "bytes.ins": 6, "bytes.del": None, "bytes.conn": 2, "bytes.total": 16}
    assert metric_value(summary, "steps") == 4
    assert metric_value(summary, "bytes.ins + bytes.del / bytes.total") == 6 / 16
    for absent in ("t99", "t99 / steps", "bytes.conn / bytes.rm"):
        assert metric_value(summary, absent) is None


def test_metrics_are_exactly_the_numbers_of_a_summary() -> None:
    summary = small_run().summary
    row = {**summary} | {f"{table}.{name}": n for table in TABLES for name, n in summary[table].items()}
    assert {name for name, value in summary.items() if isinstance(value, int | float)} <= {
        *METRICS,
        "bandwidth",
    }
    assert {*METRICS, *TABLES} <= set(summary)
    for name in (*METRICS, *(f"{table}.{number}" for table, numbers in TABLES.items() for number in numbers)):
        check(name, [])
        assert metric_value(row, name) is None or isinstance(metric_value(row, name), float)
    assert set(summary["bytes"]) <= set(TABLES["bytes"]) and set(summary["undelivered"]) <= set(
        TABLES["undelivered"]
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stepz", "'stepz' is not a metric; there are: steps, coverage,"),
        ("map", "'map' is not a metric"),
        ("bytes", "'bytes' is not a metric"),
        ("bytes.inz", "'bytes.inz' is not a metric"),
        ("steps + bytes.totl / seed", "'bytes.totl' is not a metric"),
        ("", "'' is not a metric"),
        ("steps / seed / robots", "at most one ' / '"),
        ("steps relative to ", "no variant is called ''; there are: polygons, scans"),
    ],
)
def test_an_unknown_metric_is_rejected_with_the_known_ones(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=r"there are: |must be") as caught:
        check(text, VARIANTS)
    assert message in str(caught.value)


def test_a_table_has_a_line_per_combination_of_keys_and_a_column_per_metric() -> None:
    table = Table(["robots"], ["variant"], ["steps", "bytes.total"])
    assert tabulate(table, runs()) == [
        ["robots", "variant", "n", "steps", "bytes.total"],
        ["2", "polygons", "2", "5.500", "20"],
        ["2", "scans", "2", "5.500", "40"],
    ]
    assert means(table, runs()).rows() == [("2", "polygons", 2, 5.5, 20), ("2", "scans", 2, 5.5, 40)]


@pytest.mark.parametrize("key", ["variant", "strategy", "map_encoding", "dissemination"])
def test_different_methods_are_never_averaged(key: str) -> None:
    two = [{"place": {"robots": 2, key: name}, "steps": steps} for name, steps in (("a", 4), ("b", 8))]
    table = Table(["robots"], [], ["steps"])
    assert tabulate(table, two) == [
        ["robots", key, "n", "steps"],
        ["2", "a", "1", "4.000"],
        ["2", "b", "1", "8.000"],
    ]
    assert means(table, two)["steps"].to_list() == described(table, two)["mean"].to_list() == [4, 8]
    assert tabulate(table, two[:1]) == [["robots", "n", "steps"], ["2", "1", "4.000"]]


def test_a_metric_may_be_relative_to_another_variant_of_the_same_run() -> None:
    values = ["steps", "bytes.total relative to scans"]
    assert tabulate(Table(["robots"], ["variant"], values), runs()) == [
        ["robots", "variant", "n", *values],
        ["2", "polygons", "2", "5.500", "0.500"],
        ["2", "scans", "2", "5.500", "1.000"],
    ]


def test_a_relative_metric_is_left_out_if_the_other_variant_has_not_run() -> None:
    table = Table(["seed"], [], ["bytes.total relative to scans"])
    assert [line[-1] for line in tabulate(table, runs((10, 40, 30)))[1:]] == ["0.250", "1.000", "-"]


def test_values_may_be_lists_and_tables() -> None:
    places = [{"start": [1, 2], "variant": "a"}, {"start": [3, 4], "variant": "a"}]
    table = tabulate(Table(["start"], ["variant"], ["steps"]), [{"place": p, "steps": 3} for p in places])
    assert [line[0] for line in table] == ["start", "[1, 2]", "[3, 4]"]


def test_means_of_finished_runs_have_an_interval_and_the_number_of_finished_runs() -> None:
    counts = {"leaders": [40, 50, 60], "alone": [70, 80, 90]}
    done = [
        {"place": {"map": "m", "seed": seed, "variant": name}, "steps": steps, "finished": True,
         "coverage": 0.5 if name == "alone" and seed == 0 else 1.0}
        for name, many in counts.items() for seed, steps in enumerate(many)
    ]  # fmt: skip
    table = Table(["map"], ["variant"], ["steps", "min coverage"], interval=True, finished_only=True)
    # Student's t for two degrees of freedom is 4.303: 4.303 * 10 / sqrt 3; for one it is 12.706.
    assert tabulate(table, done)[1:] == [
        ["m", "leaders", "3", "50 ± 25", "1.0000"],
        ["m", "alone", "2 of 3", "85 ± 64", "0.5000"],
    ]
    assert tabulate(table, [done[3]])[1] == ["m", "alone", "0 of 1", "-", "0.5000"]
    frame = means(table, done)
    assert frame.columns == ["map", "variant", "n", "steps", "steps ±", "min coverage"]
    assert frame["n"].to_list() == [3, 2] and frame["steps ±"].to_list() == pytest.approx(
        [24.84, 63.53], abs=0.01
    )


def test_a_cell_tells_its_number_of_runs_if_it_differs_from_the_lines() -> None:
    some = [
        {"place": {"robots": 2, "seed": seed}, "steps": 5, "t99": t99}
        for seed, t99 in enumerate((4, 6, None))
    ]
    assert tabulate(Table(["robots"], [], ["steps", "t99"]), some)[1] == ["2", "3", "5.000", "5.000 (n = 2)"]


def test_runs_that_stop_too_early_have_not_finished() -> None:
    assert has_finished({"finished": True, "coverage": 0.99})
    assert not has_finished({"finished": True, "coverage": 0.98})
    assert not has_finished({"finished": False, "coverage": 1.0})


def test_a_described_table_has_a_row_a_cell_with_interval_and_five_numbers() -> None:
    table = described(Table(["seed"], ["variant"], ["bytes.total"]), runs())
    assert table.shape == (4, 16)
    over_all = described(Table([], ["variant"], ["bytes.total"]), runs())
    (polygons, _) = over_all.iter_rows(named=True)
    assert (polygons["n"], polygons["mean"], polygons["median"], polygons["max"]) == (2, 20, 20, 30)
    assert polygons["low"] == pytest.approx(20 - 12.706 * 10, rel=1e-3)


def test_runs_without_exploration_count_as_finished() -> None:
    assert has_finished({"pixels": 3})
