"""Plug-ins given as classes, also from notebooks; names that exist, and parts that cannot run, are rejected."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from agent.encodings.scans import ScanEncoding
from agent.replication.engine import OfferDissemination
from agent.replication.policies import Offer, Rounds, Thesis
from agent.strategies.meier import Meier
from agent.strategies.registry import strategy
from agent.strategies.targets import TargetStrategy
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import Scenario
from murmur import compare, explore, sweep
from netshaper.connectivity import Links, Places
from netshaper.radio_models import RadioModel
from netshaper.settings import RadioSettings
from tests.deploy.commands.office_floor import murmur

SMALL = {"map": "leader-rooms", "robots": 2, "steps": 6, "bus": "memory"}
HERE = __name__


class First(TargetStrategy):
    """To the first goal."""

    name, summary, source = "first", "to the first goal", "our own"

    def choose(self, situation, goals, planner):  # type: ignore[no-untyped-def]
        x, y = goals[0]
        return int(x), int(y)


class Scans(ScanEncoding):
    name = "my-scans"


class ToAll(OfferDissemination):
    name = "to-all"

    def offers(self, rounds: Rounds, lengths: np.ndarray) -> list[Offer]:
        return Thesis().offers(rounds, lengths)


class Deaf(RadioModel):
    name = "deaf"

    def links(self, settings: RadioSettings, step: int, places: Places) -> Links:
        return np.eye(len(places), dtype=np.bool_)


class OneWay(RadioModel):
    name = "one-way"

    def links(self, settings: RadioSettings, step: int, places: Places) -> Links:
        return np.triu(np.ones((len(places),) * 2, np.bool_))


class PlainBytes(ScanEncoding):
    name = "plain-bytes"

    def encode_changes(self, own, scan, change, *, delivered):  # type: ignore[no-untyped-def]
        return b"".join(super().encode_changes(own, scan, change, delivered=delivered))


class BytesInAList(PlainBytes):
    name = "bytes-in-a-list"

    def encode_changes(self, own, scan, change, *, delivered):  # type: ignore[no-untyped-def]
        return [b"\x01hello"]


class Broken(First):
    name = "broken"

    def choose(self, situation, goals, planner):  # type: ignore[no-untyped-def]
        raise RuntimeError("no target")


@pytest.fixture
def in_notebook(monkeypatch: pytest.MonkeyPatch) -> type[First]:
    """A strategy that a notebook or a script defines."""

    class Mine(First):
        name = "mine"

    Mine.__module__, Mine.__qualname__ = "__main__", "Mine"
    monkeypatch.setattr(sys.modules["__main__"], "Mine", Mine, raising=False)
    return Mine


def test_classes_run_as_their_names_do() -> None:
    radio = {"model": Deaf}
    given = explore(strategy=First, map_encoding=Scans, dissemination=ToAll, radio=radio, keep=False, **SMALL)
    scenario = given.plan.scenario
    assert (scenario.strategy, scenario.radio.model) == (f"{HERE}:First", f"{HERE}:Deaf")
    assert (scenario.map_encoding, scenario.dissemination) == (f"{HERE}:Scans", f"{HERE}:ToAll")
    assert given.summary["bytes"]["total"] == 0, "no robot receives another"
    assert Scenario(strategy=Meier).strategy == "meier"
    for own, built_in in ((Scans, "scans"), (ToAll, "thesis")):
        setting = "map_encoding" if own is Scans else "dissemination"
        common = {"map_encoding": "scans", "dissemination": "thesis"} | SMALL
        ours, theirs = (
            explore(keep=False, **common | {setting: each}).summary["digest"] for each in (own, built_in)
        )
        assert ours == theirs


def test_a_class_of_a_notebook_runs_in_memory_and_is_rejected_for_processes_before_anything_starts(
    in_notebook: type[First], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = explore(strategy=in_notebook, keep=False, **SMALL)
    assert (result.plan.scenario.strategy, result.deaths) == ("__main__:Mine", {})
    with pytest.raises(ScenarioError, match=r"^strategy = '__main__:Mine': is defined in a script or a notebook.*"
                       r"move it into a module.*or set bus = 'memory'$"):  # fmt: skip
        explore(strategy=in_notebook, **SMALL | {"bus": "zenoh"})
    with pytest.raises(
        ScenarioError, match=r"notebook, from which the processes of a sweep cannot import it"
    ):
        sweep(strategy=[in_notebook, "meier"], seed=[0], progress=False, **SMALL)
    assert list(tmp_path.iterdir()) == []


def test_a_class_that_no_module_has_is_rejected() -> None:
    class Local(First):
        name = "local"

    with pytest.raises(ScenarioError, match=r"Local.* must be defined at the top level of a module"):
        Scenario(strategy=Local)
    with pytest.raises(ScenarioError, match=r"is not a subclass of agent\.encodings\.base\.MapEncoding"):
        Scenario(map_encoding=First)


def test_a_sweep_and_a_comparison_take_classes() -> None:
    done = sweep(strategy=[First, "nearest"], seed=[0], jobs=1, progress=False, **SMALL)
    assert [row["strategy"] for row in done.rows] == [f"{HERE}:First", "nearest"], done.failures
    done_too = compare(
        [{"strategy": First}, {"strategy": "nearest"}], seeds=2, jobs=1, progress=False, **SMALL
    )
    assert {row["place"]["variant"] for row in done_too.sweep.rows} == {"first", "nearest"}


MEIER = """from tests.deploy.scenario.test_plugin_classes import First

class Meier(First):
    name = "meier"

class Another(First):
    name = "first"
"""


def test_a_plug_in_with_the_name_of_another_part_is_rejected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "my_meier.py").write_text(MEIER)
    common = ("--map", "leader-rooms", "--seeds", "2", "--set", "steps=3", "--jobs", "1")
    done = murmur("compare", "--strategies", "my_meier:Meier,meier", *common)
    assert done.exit_code == 2
    assert "strategy 'my_meier:Meier': has the name 'meier' of a built-in strategy" in done.stderr
    assert strategy("meier") is Meier
    done = murmur("compare", "--strategies", f"my_meier:Another,{HERE}:First", *common)
    assert done.exit_code == 2
    assert f"strategy = '{HERE}:First': has the name 'first' of my_meier:Another" in done.stderr
    assert [path.name for path in tmp_path.iterdir() if path.suffix != ".py"] in ([], ["__pycache__"])


@pytest.mark.parametrize("encoding", [PlainBytes, BytesInAList])
def test_an_encoding_that_returns_no_packets_ends_with_an_error_that_says_what_it_must_return(
    encoding: type[ScanEncoding],
) -> None:
    result = explore(map_encoding=encoding, keep=False, check=False, **SMALL)
    assert set(result.deaths) == {"r0", "r1"}
    for report in result.deaths.values():
        assert f"map encoding {encoding.name!r}: encode_changes must return a list of packets" in report
        assert "protocol.scans.fragments" in report


def test_a_radio_model_with_one_way_links_is_reported() -> None:
    with pytest.raises(ValueError, match=r"OneWay': links must be symmetric; robot 1 receives robot 0"):
        explore(radio={"model": OneWay}, keep=False, **SMALL)
