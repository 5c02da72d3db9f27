"""The papers' claims: their shipped experiments, and the report of one claim."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from deploy.commands.app import app
from deploy.run.workers import workers
from deploy.scenario.errors import ScenarioError
from deploy.study import measures, reproduction, runs
from deploy.study.claims import UNDECIDED, judge
from deploy.study.reproduction import CLAIMS, requested
from deploy.study.results import Results


def test_there_are_24_claims_and_experiments_name_no_others() -> None:
    assert len(CLAIMS) == 24
    found = requested([], quick=False, settings={})
    shipped = sorted(reproduction.SHIPPED.glob("claim-*.toml"))
    assert sum(map(len, found.values())) == len(shipped)


def test_quick_versions_are_smaller_and_have_the_same_claims() -> None:
    whole, quick = (requested(["B1", "l1"], quick=quick, settings={}) for quick in (False, True))
    assert list(whole) == list(quick) == ["B1", "L1"]
    for name in whole:
        ((one,), (other,)) = whole[name], quick[name]
        assert len(runs.cases(other)) < len(runs.cases(one)) and one.claim == other.claim


def test_a_claim_on_real_buildings_is_undecided_without_their_maps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("MURMUR_MAPS", "nowhere")
    ((experiment,),) = requested(["M8"], quick=True, settings={}).values()
    assert experiment.grid["map"] == []
    assert runs.cases(experiment) == []
    assert experiment.claim is not None
    assert judge([(experiment.claim.rule, [])]).result == UNDECIDED


def test_a_page_has_no_links_but_to_its_own_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MURMUR_MAPS", "nowhere")
    with Results(None) as results:
        found = requested(["M8"], quick=True, settings={})
        done = reproduction.reproduce(found, results, workers(1, None), quick=True)
        page, *_ = reproduction.write(done, tmp_path / "page", "murmur reproduce M8")
    links = re.findall(r"\]\(([^)#]+)\)", page.read_text())
    assert [link for link in links if not (tmp_path / link).exists()] == []


def test_an_unknown_claim_is_named() -> None:
    with pytest.raises(ScenarioError, match="no claim is called 'B9'; there are: M1"):
        requested(["B9"], quick=True, settings={})


def test_a_file_with_a_claim_is_an_experiment_of_its_own(tmp_path: Path) -> None:
    shipped = (reproduction.SHIPPED / "claim-L1.toml").read_text()
    file = tmp_path / "mine.toml"
    file.write_text(shipped.replace("sensor_range = 2.5", "sensor_range = 4.0"))
    found = requested(["L1", str(file)], quick=False, settings={"seed": [3]})
    assert list(found) == ["L1", str(file)]
    (own,), (other,) = found[str(file)], found["L1"]
    assert own.claim is not None and own.claim == other.claim
    assert (own.base["sensor_range"], other.base["sensor_range"]) == (4.0, 2.5)
    assert own.grid["seed"] == [3]
    with pytest.raises(ScenarioError, match=r"experiment lossy\.toml has no table \[claim\]; murmur sweep"):
        requested(["lossy.toml"], quick=False, settings={})


@pytest.mark.long
def test_without_leaders_the_team_stalls_where_with_leaders_it_finishes(tmp_path: Path) -> None:
    stem = tmp_path / "docs"
    words = ["reproduce", "L1", "--quick", "--jobs", "1", "--out", str(stem), "--formats", "pdf,tex,csv"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0 and "L1" in result.stdout and "holds" in result.stdout
    page = stem.with_suffix(".md").read_text()
    assert "Here: **holds** (3 as expected; reduced)." in page
    assert "![claim-L1](docs/claim-L1-1.png)" in page and "40 of 40 runs of `claim-L1.toml`" in page
    html = stem.with_suffix(".html").read_text()
    assert '<h2 id="L1">' in html and 'src="docs/claim-L1-1.png"' in html
    assert {file.name for file in stem.iterdir()} >= {"runs.parquet", "claim-L1-1.png", "claim-L1.csv"} | {
        "claim-L1-1.pdf", "claim-L1-table.tex", "claim-L1-table.csv", "claim-L1-tests-table.tex", "claims-table.csv",
    }  # fmt: skip
    assert (
        "more runs finish with leaders & finished & difference $>$ 0 & all runs & "
        in (stem / "claim-L1-tests-table.tex").read_text()
    )
    again = CliRunner().invoke(app, ["reproduce", "L1", "--quick", "--jobs", "1", "--out", str(stem)])
    assert (
        again.exit_code == 0 and again.stdout == result.stdout and stem.with_suffix(".md").read_text() == page
    )


def test_an_assignment_by_algorithm_2_takes_longer_and_is_worth_more() -> None:
    ((experiment,),) = requested(["B3"], quick=True, settings={"robots": [8], "seed": 0}).values()
    (case,) = runs.cases(experiment)
    row = runs.run_case(case)
    assert set(measures.METRICS["assignment"]) <= set(row)
    assert row["assignment.optimal_ms"] > row["assignment.greedy_ms"]
    assert row["assignment.optimal_value"] >= row["assignment.greedy_value"]
