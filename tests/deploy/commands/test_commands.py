"""The command line: what is wrong is named with what would be right, and nothing is left behind; help teaches."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
import typer
from click.testing import Result
from PIL import Image
from typer.testing import CliRunner

from deploy.commands.main import app
from protocol.grid import MAX_SIDE
from protocol.zenoh_bus import Credential
from worldsim import generators, maps

BAD_INPUT = 2

YAML = (
    "image: {image}\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
)

FILES = {
    "broken.yaml": "image: [\n",
    "list.yaml": "- 1\n",
    "no-resolution.yaml": "image: small.png\n",
    "no-picture.yaml": YAML.format(image="none.png"),
    "no-image.yaml": YAML.format(image="text.png"),
    "text.png": "not a picture",
    "small.yaml": YAML.format(image="small.png"),
    "dark.yaml": YAML.format(image="dark.png"),
    "wide.yaml": YAML.format(image="wide.png"),
    "turned.yaml": YAML.format(image="small.png").replace("[0, 0, 0]", "[0, 0, 1]"),
    "broken.toml": "robots = \n",
    "unknown.toml": "robtos = 3\n",
    "type.toml": 'robots = "three"\n',
    "table.toml": "[[robot]]\nrobot = 0\nspede = 1\n",
    "death.toml": "robots = 2\n[[death]]\nrobot = 5\nstep = 3\n",
    "nan.toml": "speed = nan\n",
    "option.toml": "[options]\nbetta = 1\n",
    "polygon.toml": "[polygon]\nmedium_use = 0\n",
    "room.yaml": YAML.format(image="room.png"),
    "wall.toml": 'map = "room.yaml"\nstart = [0.05, 0.05]\n',
    "wide.toml": 'map = "room.yaml"\nradius = 4.0\n',
    "blind.toml": "[[robot]]\nrobot = 1\nsensor_range = 0.01\n",
    "file": "x",
    "full/x": "x",
    "half/scenario.toml": 'map = "../small.yaml"\nrobots = 1\nsteps = 2\nbus = "memory"\n',
    "half/summary.json": "{",
    "other/scenario.toml": 'map = "../small.yaml"\nrobots = 1\nsteps = 2\nbus = "memory"\n',
    "other/summary.json": "{}",
    "torn.pcapng": "no capture at all",
    "whole/scenario.toml": 'map = "../small.yaml"\nrobots = 1\nsteps = 2\nbus = "memory"\n',
    "whole/summary.json": '{"digest": "0"}',
    "broken.json": "{",
    "list.json": "[]",
    "short.json": '{"run": "a", "name": "r0"}',
    "nowhere.json": '{"run": "a", "name": "r0", "hub": "the hub", "password": "x"}',
    "bob.json": '{"run": "a", "name": "bob", "hub": "tcp/127.0.0.1:1", "password": "x"}',
}


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder to work in, full of files that something is wrong with."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    for name, shape, shade in (("small", (10, 10), 255), ("dark", (10, 10), 0), ("wide", (3, 2049), 255)):
        Image.fromarray(np.full(shape, shade, np.uint8)).save(tmp_path / f"{name}.png")
    room = np.zeros((10, 10), np.uint8)
    room[1:-1, 1:-1] = 255
    Image.fromarray(room).save(tmp_path / "room.png")
    Credential("a", "r0", "tcp/127.0.0.1:1", "x").write(tmp_path / "r0.json")
    monkeypatch.chdir(tmp_path)
    yield tmp_path


def murmur(*arguments: str) -> Result:
    """Call the command in this process."""
    return CliRunner().invoke(app, arguments)


def contents(folder: Path) -> dict[str, int]:
    return {str(path.relative_to(folder)): path.stat().st_mtime_ns for path in folder.rglob("*")}


EXPLORE = {
    "--map missing.yaml": "missing.yaml: cannot be read (No such file or directory); give a map_server YAML file",
    "--map broken.yaml": "broken.yaml: is not YAML",
    "--map list.yaml": "list.yaml: holds no `key: value` lines; a map_server YAML file names image, resolution",
    "--map no-resolution.yaml": "no-resolution.yaml: resolution is missing",
    "--map no-picture.yaml": "none.png: cannot be read (No such file or directory); `image` must name a PGM or",
    "--map no-image.yaml": "text.png: is not a whole PGM or PNG picture",
    "--map dark.yaml": "dark.yaml: no cell is free; check negate and the thresholds",
    "--map wide.yaml": f"wide.png: is 2049 x 3 cells, and {MAX_SIDE} x {MAX_SIDE} is the most",
    "--map turned.yaml": "turned.yaml: origin is turned by 1.0 rad; turn the picture instead",
    "--map offise": "no environment is called 'offise'; there are unstructured, mixed, office,",
    "--range -3": "range = '-3': must be a distance of 0 or more: metres, as 12.5, or a share of the diagonal",
    "--range nan": "range = 'nan': must be a distance",
    "--strategy leaders --range 3": "range = '3': leaders needs rho_lead <= range, not rho_lead = 4 m with",
    "--strategy leaders --range 5%": "range = '5%': leaders needs rho_lead <= range, not rho_lead = 4 m with a",
    "--strategy leaders --range 5 --option rho_lead=6": "not rho_lead = 6 m with a range of 5 m: a leader that cannot",
    "--range -5%": "range = '-5%': must be a distance",
    "--range far": "range = 'far': must be a distance",
    "--robots 0": "robots = 0: Input should be greater than or equal to 1",
    "--robots 65": "robots = 65: packets can name the maps of 64 robots",
    "--robots three": "Invalid value for '--robots'",
    "--robots 30 --map small.yaml": "30 robots do not fit: 16 free cells lie 3 cells apart",
    "--strategy best": "no strategy is called 'best'; there are: burgard,",
    "--exchange radio": "exchange = 'radio': there are: polygon, laser, none",
    "--offers never": "offers = 'never': Input should be 'backoff' or 'thesis'",
    "--bus can": "bus = 'can': Input should be 'zenoh' or 'memory'",
    "--option beta": "option = 'beta': must be NAME=VALUE, as beta=0.5",
    "--option gamma=3": "meier has no option 'gamma'; there are: candidates,",
    "--option beta=x": "option beta of meier must be float, not 'x'",
    "--option beta=NaN": "beta must lie between",
    "--bandwidth -1": "bandwidth = '-1': must be a whole number of bytes a step, 0 to",
    "--bandwidth 1kB": "bandwidth = '1kB': must be a whole number of bytes a step",
    "--bandwidth nan": "bandwidth = 'nan': must be a whole number of bytes a step",
    "--sensor-range 0.05": "sensor_range = 0.05 m of robot 0 is less than a cell of 0.1 m",
    "--sensor-range nan": "sensor_range = nan",
    "--speed 0": "speed = 0.0: Input should be greater than 0",
    "--speed nan": "speed = nan",
    "--steps 0": "steps = 0: Input should be greater than or equal to 1",
    "--seed -1": "seed = -1: Input should be greater than or equal to 0",
    "--start 0,0": "cell (0, 250) is not free: robots cannot start there; murmur map show office draws where",
    "--start -50,3": "is not free: robots cannot start there",
    "--start nan,1": "start.0 = nan",
    "--start 3": "start = '3': must be two numbers of metres, as 3.5,12",
    "--pace 0": "pace = 0: must be 0.5 steps a second or more",
    "--view-as hologram": "view-as = 'hologram': must be one of auto, native, web, file",
    "--out full": "out = full: it exists already; name a new directory, or empty this one",
    "--out file": "out = file: it exists already; name a new directory",
    "--out file/run": "out = file/run: cannot be made: Not a directory",
    "missing.toml": "scenario missing.toml: no such file; shipped ones are",
    "full": "scenario full: Is a directory",
    "broken.toml": "scenario broken.toml: not TOML: Invalid value (at line 1, column 10)",
    "unknown.toml": "scenario unknown.toml: robtos is no setting; there are: map, map_seed, robots,",
    "type.toml": "scenario type.toml: robots = 'three': Input should be a valid integer",
    "table.toml": "robot.0.spede is no setting; there are: robot, sensor_range, field_of_view, speed",
    "death.toml": "[[death]] speaks of robot 5; the last one is 1",
    "nan.toml": "scenario nan.toml: speed = nan",
    "option.toml": "meier has no option 'betta'; there are: candidates,",
    "polygon.toml": "medium_use = 0: must be above 0 and at most 100",
    "wide.toml": "start on map room: no cell is free for robots of that radius",
    "wall.toml": "start on map room: cell (0, 9) is not free",
    "blind.toml": "sensor_range = 0.01 m of robot 1 is less than a cell of 0.1 m",
    "--nonsense": "No such option: --nonsense",
}

OTHERS = {
    "map make castle": "no environment is called 'castle'; there are",
    "map make em --seed -1": "Invalid value for '--seed'",
    "map make em --out em.png": "out = em.png: must end in .yaml; the picture is written beside it",
    "map make em --out nowhere/em.yaml": "No such file or directory",
    "map show missing.yaml": "missing.yaml: cannot be read",
    "map show em --png nowhere/em.png": "nowhere/em.png: No such file or directory",
    "replay missing": "missing: no run directory, for it has no scenario.toml",
    "replay half": "half: no readable summary.json",
    "replay other": "other: summary.json is not that of a run, for it has no finished, reason, steps,",
    "replay whole": "whole: summary.json is not that of a run, for it has no finished, reason, steps,",
    "replay whole --bus can": "bus = 'can': Input should be 'zenoh' or 'memory'",
    "report full": "full: no run directory, for it has no scenario.toml",
    "export full --mcap": "full: no run directory, for it has no scenario.toml",
    "watch full": "full: no recording (run.rrd), and no run is under way there",
    "capture missing": "missing: No such file or directory",
    "capture torn.pcapng": "torn.pcapng: not a pcapng file",
    "capture torn.pcapng --json": "torn.pcapng: not a pcapng file",
    "capture whole --robot 1": "robot = 1: the last one of this run is 0",
    "capture": "name a run directory, or use --install-dissector",
    "capture full --kind x": "kind = 'x': there are ins, rep, del,",
    "capture full --step x": "step = 'x': must be a step, as 12, or steps, as 10-20",
    "capture full --step 5-2": "step = '5-2': the first step comes first, as in 10-20",
    "sweep missing.toml": "experiment missing.toml: no such file; shipped ones are kilobyte.toml, lossy.toml,",
    "sweep broken.toml": "experiment broken.toml: not TOML",
    "strategies burgart": "no strategy is called 'burgart'; did you mean burgard or burgard-optimal?",
    "bench speed": "no bench is called 'speed'; there are: kernels, bus, swarm",
    "run agent": "Missing option '--credential'",
    "run agent --credential missing.json": "credential missing.json: No such file or directory",
    "run agent --credential broken.json": "credential broken.json: not JSON",
    "run agent --credential list.json": "credential list.json: needs the texts run, name, hub, password",
    "run agent --credential short.json": "credential short.json: needs the texts run, name, hub, password",
    "run agent --credential nowhere.json": "hub = 'the hub': must be as tcp/127.0.0.1:7447",
    "run agent --credential bob.json": "'bob' is not a robot's name",
    "run worldsim --credential r0.json": "credential r0.json is that of r0; world.json is needed here",
    "run lab --credential r0.json": "credential r0.json is that of r0; lab.json is needed here",
    "run view --credential r0.json": "credential r0.json is that of r0; view.json is needed here",
    "run netshaper --listen here": "listen = 'here': must be HOST:PORT, as 127.0.0.1:7447",
    "run netshaper --listen 127.0.0.1:0": "listen = '127.0.0.1:0': must be HOST:PORT, as 127.0.0.1:7447, with",
    "run netshaper --listen 127.0.0.1:65536": "with a port from 1 to 65535",
    "run netshaper --listen 0.0.0.0:7447": "listen = '0.0.0.0:7447': stands in every credential, and nobody can",
    "run netshaper --listen [::]:7447": "give the address by which others know this host",
    "run netshaper --credentials full": "credentials = full: it exists already; name a new directory",
    "run netshaper --credentials file": "credentials = file: it exists already; name a new directory",
    "fly": "No such command 'fly'",
}


@pytest.mark.parametrize("words", [f"explore {words}" for words in EXPLORE] + list(OTHERS))
def test_bad_input_is_named_with_what_would_be_right_and_leaves_nothing_behind(
    desk: Path, words: str
) -> None:
    complaint = OTHERS.get(words) or EXPLORE[words.removeprefix("explore ")]
    before = contents(desk)
    result = murmur(*words.split())
    said = result.stderr.replace("\n", " ")
    assert result.exit_code == BAD_INPUT, said
    assert complaint in said
    assert "Traceback" not in said
    assert said.startswith(("murmur: ", "Usage: "))
    assert contents(desk) == before


def test_several_things_that_are_wrong_are_all_named(desk: Path) -> None:
    result = murmur("explore", "--robots", "0", "--speed", "-1", "--exchange", "x")
    assert result.exit_code == BAD_INPUT
    assert [line.split(" = ")[0] for line in result.stderr.splitlines()] == [
        f"murmur: scenario: {key}" for key in ("robots", "exchange", "speed")
    ]


def test_bad_input_says_nothing_on_the_channel_that_machines_read(desk: Path) -> None:
    for words in (
        ["explore", "--json", "--range", "-3"],
        ["replay", "--json", "full"],
        ["bench", "x", "--json"],
        ["capture", "torn.pcapng"],
        ["capture", "torn.pcapng", "--json"],
    ):
        result = murmur(*words)
        assert (result.exit_code, result.stdout) == (BAD_INPUT, "")


def test_bad_input_ends_the_real_command_as_well(desk: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "deploy.commands.main", "explore", "--range", "-3"],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (BAD_INPUT, "")
    assert done.stderr.startswith("murmur: scenario: range = '-3': must be a distance of 0 or more")
    assert not (desk / "runs").exists()


def test_a_file_that_is_called_as_the_folder_of_runs_is_in_the_way(desk: Path) -> None:
    (desk / "runs").write_text("x")
    result = murmur("explore", "--map", "room.yaml", "--robots", "1", "--bus", "memory")
    assert result.exit_code == BAD_INPUT
    assert "runs is a file, and runs go into a directory of that name: move it, or use --out" in result.stderr


# --- help ----------------------------------------------------------------------------------------------


def commands() -> dict[str, click.Command]:
    """All commands, by the words that call them."""
    found: dict[str, click.Command] = {}

    def walk(command: click.Command, words: tuple[str, ...]) -> None:
        found[" ".join(words)] = command
        for name, inner in getattr(command, "commands", {}).items():
            walk(inner, (*words, name))

    walk(typer.main.get_command(app), ())
    return found


@pytest.mark.parametrize("words", commands())
def test_help_ends_well_and_teaches(words: str) -> None:
    command = commands()[words]
    for flag in ("--help", "-h"):
        result = murmur(*words.split(), flag)
        assert result.exit_code == 0
        assert result.stderr == ""
    said = " ".join(result.stdout.split())
    assert command.help
    assert command.help.split(".")[0].split()[0] in said
    for parameter in command.params:
        assert getattr(parameter, "help", None), f"{parameter.name} has no help"
        if isinstance(parameter, click.Option):
            assert max(parameter.opts, key=len) in said
    for inner in getattr(command, "commands", {}):
        assert inner in said


def test_the_first_help_says_how_to_begin_and_what_exit_codes_mean() -> None:
    said = " ".join(murmur("--help").stdout.split())
    assert "Begin with: murmur explore --robots 5" in said
    assert "0 explored, 1 not finished" in said
    assert "2 bad input, 3 a process died" in said


def test_without_a_word_the_command_helps() -> None:
    result = murmur()
    assert "Usage: " in result.stdout + result.stderr
    assert "explore" in result.stdout + result.stderr


def test_help_of_explore_names_defaults_and_choices() -> None:
    said = " ".join(murmur("explore", "--help").stdout.split())
    for words in (
        "how many robots explore (default 3)",
        "how maps travel: polygon, laser, none (default polygon)",
        "bytes a step for the whole team (default 1000)",
        "communication range: metres, or % of the map's diagonal (default 100%)",
    ):
        assert words in said
    assert "None" not in said


# --- what works ----------------------------------------------------------------------------------------


@pytest.fixture
def floor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    maps.save(generators.make("office", width_m=10, height_m=10), tmp_path / "floor.yaml")
    return "floor.yaml"


def explore(floor: str, *more: str) -> Result:
    return murmur("explore", "--map", floor, "--bus", "memory", "--robots", "2", *more)


def test_a_run_tells_people_how_it_went_and_where_everything_is(floor: str) -> None:
    result = explore(floor)
    assert result.exit_code == 0, result.stderr
    lines = result.stdout.splitlines()
    assert lines[0].startswith("Explored in ")
    assert "100.00 % of what can be reached" in lines[1]
    directory = Path("runs/floor-polygon-2robots-seed0")
    assert f"Everything is in {directory}; look at {directory / 'maps.png'}." in lines[-1]
    assert (directory / "summary.json").exists()
    assert "runs/floor-polygon-2robots-seed0-2" in explore(floor, "--steps", "3").stdout


def test_machines_get_one_json_object_and_nothing_else(floor: str) -> None:
    result = explore(floor, "--json", "--out", "run")
    summary: dict[str, Any] = json.loads(result.stdout)
    assert summary == json.loads(Path("run/summary.json").read_text())
    assert result.stderr == ""


def test_a_run_that_does_not_finish_ends_with_1(floor: str) -> None:
    result = explore(floor, "--steps", "3")
    assert result.exit_code == 1
    assert "Not finished after 3 steps: out of steps." in result.stdout


def test_flags_override_the_scenario(floor: str) -> None:
    Path("s.toml").write_text(f'map = "{floor}"\nrobots = 2\nsteps = 3\nbus = "memory"\nseed = 5\n')
    result = murmur("explore", "s.toml", "--seed", "6", "--option", "beta=2", "--json", "--out", "run")
    assert json.loads(result.stdout)["seed"] == 6
    written = Path("run/scenario.toml").read_text()
    assert "beta = 2" in written
    assert "robots = 2" in written


def test_the_thesis_plain_rules_are_one_flag(floor: str) -> None:
    explore(floor, "--thesis", "--steps", "2", "--out", "run")
    written = Path("run/scenario.toml").read_text()
    for line in ('offers = "thesis"', "lazy = false", "mixed_first = false", "free_inside_edges = true"):
        assert line in written


def test_a_replay_says_whether_the_run_holds(floor: str) -> None:
    explore(floor, "--steps", "8", "--out", "run")
    result = murmur("replay", "run")
    assert (result.exit_code, result.stdout[:13]) == (0, "The run holds")
    found = json.loads(murmur("replay", "run", "--json").stdout)
    assert found["holds"]
    assert found["digest"] == found["before"]
    summary = json.loads(Path("run/summary.json").read_text())
    Path("run/summary.json").write_text(json.dumps(summary | {"digest": "0" * 64, "steps": 7}))
    result = murmur("replay", "run")
    assert result.exit_code == 1
    assert "does not hold" in result.stderr
    assert "steps: 7 then, 8 now" in result.stderr


def test_a_replay_names_the_settings_that_have_changed_first(floor: str) -> None:
    explore(floor, "--steps", "4", "--out", "run")
    scenario = Path("run/scenario.toml")
    scenario.write_text(scenario.read_text().replace("robots = 2", "robots = 3"))
    result = murmur("replay", "run")
    assert result.exit_code == 1
    assert result.stderr.splitlines()[1] == "  robots: 2 then, 3 now"
    assert "map: " not in result.stderr


@pytest.mark.parametrize(
    ("what", "why"),
    [
        ({"reason": "interrupted"}, "it was interrupted at step 4"),
        ({"reason": "broken off"}, "it was broken off at step 4"),
        ({"lost": {"1": "its process ended"}}, "robot 1 was lost: its process ended, unasked"),
    ],
)
def test_what_befell_a_run_from_outside_cannot_be_replayed(
    floor: str, what: dict[str, Any], why: str
) -> None:
    explore(floor, "--steps", "4", "--out", "run")
    summary = json.loads(Path("run/summary.json").read_text())
    Path("run/summary.json").write_text(json.dumps(summary | what))
    result = murmur("replay", "run")
    assert (result.exit_code, result.stdout) == (BAD_INPUT, "")
    assert result.stderr == f"murmur: run: this run cannot be repeated: {why}\n"


def test_a_run_says_where_its_pictures_are(floor: str) -> None:
    said = explore(floor, "--steps", "4", "--out", "run", "--pictures").stdout
    assert "Everything is in run; look at run/maps.png and run/pictures." in said


FULL_DISK = """
import resource, sys
from deploy.after import export, report
from deploy.commands import main
resource.setrlimit(resource.RLIMIT_FSIZE, (9000, resource.RLIM_INFINITY))
main.app(sys.argv[1:])
"""


@pytest.mark.parametrize("words", ["explore --map floor.yaml --bus memory --out two --json", "report run"])
def test_a_full_disk_is_named_with_the_file_and_ends_with_3(floor: str, words: str) -> None:
    explore(floor, "--steps", "30", "--out", "run")
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, *words.split()],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])},
        capture_output=True,
        text=True,
        check=False,
    )
    last = done.stderr.splitlines()[-1]
    assert (done.returncode, done.stdout) == (3, ""), done.stderr
    assert last.startswith("murmur: ")
    assert last.endswith("File too large")
    assert "Traceback" not in done.stderr
    assert not list(Path("run").glob("pictures/*"))


def test_maps_can_be_made_shown_and_explored(floor: str) -> None:
    assert murmur("map", "make", "em", "--out", "hall.yaml").stdout.startswith("hall.yaml: 21 x 24 m")
    shown = murmur("map", "show", "hall.yaml", "--png", "hall.png.png")
    assert "hall: 420 x 480 cells of 0.05 m" in shown.stdout
    assert {"█", " "} <= set(shown.stdout), "walls and rooms can be told apart without colours"
    assert Path("hall.png.png").exists()
    assert explore("hall.yaml", "--steps", "2").exit_code == 1
    listed = murmur("map", "list").stdout
    assert all(name in listed for name in generators.names())
