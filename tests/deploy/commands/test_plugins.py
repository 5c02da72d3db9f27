"""Plug-ins of installed packages are found by name, listed and run; broken ones are reported."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest

HERE = Path(__file__).parents[3]
INFO = {
    "METADATA": "Metadata-Version: 2.1\nName: farthest-first\nVersion: 1\n",
    "WHEEL": "Wheel-Version: 1.0\nGenerator: hand\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    "entry_points.txt": "[murmur.strategies]\nfarthest = farthest_first:Farthest\ntorn = torn_strategy:Torn\n"
    "[murmur.map_encodings]\nquiet = farthest_first:Quiet\n[murmur.radio_models]\nnear = farthest_first:Near\n"
    "[murmur.radio_presets]\nslow = farthest_first:SLOW\n[murmur.disseminations]\nshy = farthest_first:Shy\n",
    "RECORD": "",
}
MODULE = '''
import numpy as np
from agent.encodings.none import NoEncoding
from agent.replication.engine import OfferDissemination
from agent.strategies.targets import TargetStrategy
from netshaper.radio_models import RadioModel
from protocol.presets import Preset

SLOW = Preset("slow", 800, 64, 0.64, 10)

class Farthest(TargetStrategy):
    """To the farthest goal."""
    name, summary, source = "farthest", "to the farthest goal", "our own, section 1"

    def choose(self, situation, goals, planner):
        costs = planner.costs(*situation.here)[goals[:, 1], goals[:, 0]]
        x, y = goals[np.argmax(costs)]
        return int(x), int(y)

class Quiet(NoEncoding):
    """Tells nothing."""
    name = "quiet"

class Near(RadioModel):
    """Neighbors only."""
    name = "near"

    def links(self, settings, step, places):
        return np.abs(places[:, None] - places).max(axis=2) < 10

class Shy(OfferDissemination):
    """Offers nothing."""
    name = "shy"

    def offers(self, rounds, lengths):
        return []
'''


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder into which a package with a strategy and an exchange has been installed."""
    folder, target = tmp_path_factory.mktemp("wheel"), tmp_path_factory.mktemp("target")
    with ZipFile(folder / "farthest_first-1-py3-none-any.whl", "w") as wheel:
        for name, text in INFO.items():
            wheel.writestr(f"farthest_first-1.dist-info/{name}", text)
        wheel.writestr("farthest_first.py", MODULE)
        wheel.writestr("torn_strategy.py", "raise RuntimeError('torn')\n")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--no-index"]
    subprocess.run([*pip, "--no-deps", "--target", target, *folder.iterdir()], check=True)
    return target


def python(installed: Path, *words: str) -> subprocess.CompletedProcess[str]:
    env = os.environ | {"PYTHONPATH": f"{HERE}:{installed}"}
    return subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, env=env, cwd=installed, check=False
    )


def test_parts_of_a_package_run_by_their_names(installed: Path) -> None:
    run = "from murmur import explore; print(explore(map='em', robots=2, steps=4, bus='memory', keep=False, "
    parts = "map_encoding='quiet', dissemination='shy', radio={'model': 'near', 'preset': 'slow'}"
    done = python(installed, "-c", f"{run}strategy='farthest', {parts}).plan.scenario.radio)")
    assert "preset='slow', frame_bytes=64, model='near'" in done.stdout, done.stderr
    torn = python(installed, "-c", run + "strategy='torn'))")
    assert "strategy 'torn' of package farthest-first cannot be imported:" in torn.stderr
    assert torn.stderr.endswith("RuntimeError: torn\n")
    wrong = python(installed, "-c", run + "strategy='fartest', map_encoding='quite'))")
    assert "no map encoding is called 'quite'; did you mean quiet? There are: polygons," in wrong.stderr


def test_strategies_of_a_package_are_listed_even_if_their_import_fails(installed: Path) -> None:
    listed = python(installed, "-m", "deploy.commands.main", "strategies")
    assert listed.returncode == 0, listed.stderr
    printed = " ".join(listed.stdout.split())
    assert "our own farthest section 1 to the farthest goal" in printed
    assert "package farthest-first torn cannot be imported: RuntimeError: torn" in printed


def called(installed: Path, *commands: str) -> list[dict[str, Any]]:
    """Call commands of murmur in one process; return the exit code, output, and errors of each."""
    done = python(installed, "-c", CALL, *commands)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


CALL = """
import json, shlex, sys
from typer.testing import CliRunner
from deploy.commands.app import app

for words in sys.argv[1:]:
    done = CliRunner().invoke(app, shlex.split(words))
    print(json.dumps({"code": done.exit_code, "output": done.stdout, "errors": done.stderr}))
assert "torn_strategy" not in sys.modules
"""


def test_finished_runs_are_read_without_the_code_that_their_scenario_names(
    installed: Path, tmp_path: Path
) -> None:
    """The module `torn_strategy` fails when it is imported; replay runs code of other folders only if it is trusted."""
    run = str(tmp_path / "run")
    settings = "--map em --robots 2 --steps 4 --bus memory --strategy farthest"
    explored, refused, trusted = called(
        installed, f"explore {settings} --out {run}", f"replay {run}", f"replay {run} --trust"
    )
    assert (explored["code"], refused["code"]) == (1, 2)
    place = f"module farthest_first ({installed / 'farthest_first.py'})"
    assert refused["errors"] == (
        f"murmur: {run}: would run {place}, which is no installed package: read it, then use --trust\n"
    )
    assert trusted["output"].startswith("Replay matches")

    copies = []
    for number, name in enumerate(("torn", "torn_strategy:Torn", "no_longer_there:Strategy")):
        copies.append(shutil.copytree(run, tmp_path / f"copy-{number}"))
        scenario = copies[-1] / "scenario.toml"
        lines = scenario.read_text().splitlines()
        changed = [f'strategy = "{name}"' if line.startswith("strategy = ") else line for line in lines]
        scenario.write_text("\n".join(changed))
        summary = copies[-1] / "summary.json"
        summary.write_text(json.dumps(json.loads(summary.read_text()) | {"strategy": name}))
    reading = [
        *(f"capture --robot 0 {copy}" for copy in copies),
        f"report {copies[1]}",
        f"export --mcap {copies[1]}",
    ]
    by_name, by_module, missing, torn, *read = called(
        installed, *(f"replay {copy}" for copy in copies), f"replay {copies[2]} --trust", *reading
    )
    assert [each["code"] for each in read] == [0] * len(reading), read
    assert [each["code"] for each in (by_name, by_module, missing, torn)] == [2, 2, 2, 2]
    assert "module torn_strategy" in by_name["errors"]
    assert "module torn_strategy" in by_module["errors"]
    assert "module torn_strategy" not in missing["errors"]
    assert "No module named 'no_longer_there'" in missing["errors"]
    assert "Traceback" not in torn["errors"]
