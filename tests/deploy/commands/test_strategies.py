"""`murmur strategies`: the list of strategies, and their options."""

from __future__ import annotations

import json

import pytest
from click.testing import Result
from typer.testing import CliRunner

from agent.strategies.catalog import COMBINING, catalog, entry
from agent.strategies.registry import strategies
from agent.strategies.targets import Parts
from deploy.commands.app import app
from deploy.commands.strategies import WIDTH


def murmur(*arguments: str) -> Result:
    return CliRunner().invoke(app, arguments)


def test_the_list_has_each_strategy_with_its_summary_and_section() -> None:
    lines = murmur("strategies").stdout.splitlines()
    for known in catalog():
        at = lines.index(f"  {known.name}  {known.section}")
        assert lines[at + 1].strip() == known.summary
    assert {known.paper for known in catalog()} <= set(lines)
    assert any("Default: repairmen." in line for line in lines)
    assert max(map(len, lines)) <= WIDTH


@pytest.mark.parametrize("name", sorted(strategies()))
def test_a_strategy_is_shown_with_all_options_their_defaults_and_choices(name: str) -> None:
    output = murmur("strategies", name).stdout
    assert max(map(len, output.splitlines())) <= WIDTH
    one_line = " ".join(output.split())
    shown = entry(name)
    for words in (shown.summary, shown.source, *shown.clashes, *shown.refused.values()):
        assert words in one_line
    for option in shown.options:
        default = json.dumps(option.default) if isinstance(option.default, bool) else str(option.default)
        assert f"{option.name} {default} {option.help}" in one_line
        assert ", ".join(option.choices) in one_line


@pytest.mark.parametrize("name", ["meier", "agent.strategies.meier:Meier"])
def test_the_last_line_runs_the_strategy_that_was_asked_for(name: str) -> None:
    last = murmur("strategies", name).stdout.splitlines()[-1]
    assert last == f"murmur explore --strategy {name} --option NAME=VALUE"


def test_a_choice_that_does_not_fit_is_named_with_the_reason() -> None:
    output = " ".join(murmur("strategies", "mtsp").stdout.split())
    assert "mtsp cannot have candidates = cells: a tour needs the way between every two goals" in output


def test_machines_get_the_same_as_json() -> None:
    found = json.loads(murmur("strategies", "--json").stdout)
    assert list(found) == sorted(strategies())
    one = json.loads(murmur("strategies", "meier", "--json").stdout)
    assert one == {"meier": found["meier"]}
    beta = next(option for option in one["meier"]["options"] if option["name"] == "beta")
    assert (beta["default"], beta["help"]) == (1.0, "weight of cost against utility")


def test_help_explains_line_by_line_how_parts_combine() -> None:
    lines = [line.strip() for line in murmur("strategies", "--help").stdout.splitlines()]
    for line in COMBINING.splitlines():
        assert line.strip() in lines
    for part in Parts.__dataclass_fields__:
        assert any(line.startswith(part) for line in lines)


@pytest.mark.parametrize(
    ("wrong", "output"),
    [
        ("burgart", "no strategy is called 'burgart'; did you mean burgard or burgard-optimal? There are: burgard,"),
        ("Leader", "did you mean leaders?"),
        ("zzz", "no strategy is called 'zzz'; there are: burgard,"),
        ("pathlib:Path", "Path is not a subclass of agent.strategies.base.Strategy"),
    ],
)  # fmt: skip
def test_an_unknown_name_is_bad_input_and_near_ones_are_named(wrong: str, output: str) -> None:
    result = murmur("strategies", wrong)
    assert (result.exit_code, result.stdout) == (2, "")
    assert output in " ".join(result.stderr.split())
