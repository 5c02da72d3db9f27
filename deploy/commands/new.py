"""`murmur new`: templates of new code, each with a test that passes."""

from __future__ import annotations

import keyword
import sys
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Annotated

import typer

from deploy.commands.console import screen
from deploy.commands.flags import Subcommands, command_family

app = command_family()
new_app = typer.Typer(
    cls=Subcommands,
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Write a template of new code, with its test.",
)
app.add_typer(new_app, name="new")

STRATEGY = '''"""An exploration strategy: {title}. Run it: murmur explore --strategy {module}:{kind}"""

import numpy as np

from agent.strategies.targets import TargetStrategy


class {kind}(TargetStrategy):
    """Each robot drives to the frontier cell with the highest value; here, to the farthest."""

    name = "{name}"
    summary = "each robot drives to the frontier cell that is farthest from it"
    source = "our own"

    def choose(self, situation, goals, planner):
        """Choose one of `goals`, reachable cells (x, y) of shape (n, 2).

        `situation` is the robot's knowledge: its cell `here`, teammates' last `targets` and `poses`, its planning
        `grid` (agent.strategies.base.Situation). `planner.costs(x, y)` is the path cost from a cell to every other
        cell, shape (h, w), in cells.
        """
        costs = planner.costs(*situation.here)[goals[:, 1], goals[:, 0]]
        x, y = goals[np.argmax(costs)]
        return int(x), int(y)
'''

TEST = '''"""Strategy {name} explores the whole map, and equal runs give equal results. Run: python -m pytest {test}"""

import murmur

SCENARIO = murmur.Scenario(map="jh-like", robots=2, strategy="{module}:{kind}", bandwidth="unlimited", bus="memory")


def test_it_explores_the_whole_map():
    result = murmur.explore(SCENARIO, keep=False)
    assert result.summary["finished"], result.summary["reason"]
    assert result.summary["coverage"] > 0.99


def test_equal_runs_give_equal_results():
    first, second = (murmur.explore(SCENARIO, keep=False).summary["digest"] for _ in range(2))
    assert first == second
'''


@new_app.command("strategy")
def new_strategy(
    name: Annotated[str, typer.Argument(metavar="NAME", help="name of the strategy, as farthest or my-way")],
) -> None:
    """Write a strategy and its test into the current folder: one class to change."""
    module = name.replace("-", "_")
    if not module.isidentifier() or keyword.iskeyword(module) or not module.islower():
        raise ValueError(f"name = {name!r}: must be lower-case letters, digits and hyphens, as my-way")
    if module in sys.stdlib_module_names or module in packages_distributions():
        raise ValueError(
            f"name = {name!r}: would hide the Python module of this name; choose another name, as my-{name}"
        )
    file, test = Path(f"{module}.py"), Path(f"test_{module}.py")
    for path in (file, test):
        if path.exists():
            raise ValueError(f"{path}: already exists; choose another name")
    kind = "".join(part.capitalize() for part in module.split("_"))
    title = name.replace("-", " ")
    file.write_text(STRATEGY.format(name=name, module=module, kind=kind, title=title), encoding="utf-8")
    test.write_text(TEST.format(name=name, module=module, kind=kind, test=test), encoding="utf-8")
    screen.print(f"{file}: the strategy; {test}: its test")
    screen.print(f"run:  murmur explore --strategy {module}:{kind}")
    screen.print(f"test: python -m pytest {test}")
