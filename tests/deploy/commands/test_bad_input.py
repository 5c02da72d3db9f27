"""Bad input: errors name the value and the valid values, and no file is written."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from protocol.grid import MAX_SIDE
from protocol.zenoh_bus import Credential
from tests.deploy.commands.office_floor import murmur

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
    "lasers.toml": '[[robot]]\nrobot = 0\nlaser = "lidar"\n',
    "lasers2.toml": "[[robot]]\nrobot = 0\nlaser = { mising = 0.1 }\n",
    "lasers3.toml": "[[robot]]\nrobot = 0\nlaser = { missing = true }\n",
    "lasers4.toml": "[[robot]]\nrobot = 0\nlaser = 3\n",
    "lasers5.toml": '[[robot]]\nrobot = 3\npose = "graph-slam"\n',
    "lasers6.toml": "[[robot]]\nrobot = 0\npose = { position_error_m = -1.0 }\n",
    "fault.toml": 'robots = 2\n[[fault]]\nrobot = 5\nstep = 3\nkind = "death"\n',
    "nan.toml": "speed = nan\n",
    "option.toml": "[options]\nbetta = 1\n",
    "polygon.toml": "[polygons]\nmedium_use = 0\n",
    "room.yaml": YAML.format(image="room.png"),
    "wall.toml": 'map = "room.yaml"\nstart = [0.05, 0.05]\n',
    "wide.toml": 'map = "room.yaml"\nradius = 4.0\n',
    "blind.toml": "[[robot]]\nrobot = 1\nsensor_range = 0.01\n",
    "file": "x",
    "full/x": "x",
    "half/scenario.toml": 'map = "../small.yaml"\nrobots = 1\nsteps = 2\nbus = "memory"\n',
    "half/summary.json": "{",
    "killed/scenario.toml": 'map = "../small.yaml"\nrobots = 1\n',
    "other/scenario.toml": 'map = "../small.yaml"\nrobots = 1\nsteps = 2\nbus = "memory"\n',
    "other/summary.json": "{}",
    "torn.pcapng": "no capture at all",
    "whole/scenario.toml": 'map = "../small.yaml"\nrobots = 1\nsteps = 2\nbus = "memory"\n',
    "whole/summary.json": '{"digest": "0"}',
    "broken.json": "{",
    "list.json": "[]",
    "short.json": '{"run": "a", "name": "r0"}',
    "nowhere.json": '{"run": "a", "name": "r0", "hub": "the hub", "password": "x"}',
    "deep.toml": "options = " + 5000 * "[" + 5000 * "]",
    "deep.yaml": 5000 * "[" + 5000 * "]",
    "deep.json": '{"depth": ' + 100_000 * "[",
    "endless.yaml": YAML.format(image="/dev/zero"),
    "coarse.yaml": YAML.format(image="room.png").replace("0.1", "900000", 1),
    "afar.yaml": YAML.format(image="room.png").replace("[0, 0, 0]", "[1.0e+308, 0, 0]"),
    "afar.toml": "[[change]]\nstep = 1\nrange = 1e300\n",
    "preset.toml": '[radio]\npreset = ["wifi"]\n',
    "reuse.toml": '[radio]\nreuse = "yes"\n',
    "groups.toml": '[[radio.partition]]\nfirst = 1\nlast = 2\ngroups = [["0"], [1]]\n',
    "share.toml": "min_coverage = true\n",
    "digits.toml": f"robots = {5000 * '9'}\n",
    "seeds.toml": "seeds = 1000000000000\n[base]\nrobots = 2\n",
    "runs.toml": "seeds = 1000\n[grid]\nbeams = [36, 72, 180, 360]\n" + f"steps = {list(range(1, 101))}\n",
    "palette.yaml": YAML.format(image="palette.png"),
    "bomb.yaml": YAML.format(image="room.png").replace("0.1", "*n9")
    + "n0: &n0 [x]\n"
    + "".join(f"n{n}: &n{n} [{', '.join(9 * [f'*n{n - 1}'])}]\n" for n in range(1, 10)),
    "date.yaml": YAML.format(image="room.png").replace("0.1", "2026-13-45", 1),
    "hosts.toml": 'address = "10.0.0.1"\n[[host]]\nname = "a"\nrobots = 999999999999999999999999\n',
    "star.json": '{"run": "a*", "name": "r0", "hub": "tcp/127.0.0.1:1", "password": "x"}',
    "port.json": '{"run": "a", "name": "r0", "hub": "tcp/127.0.0.1:99999", "password": "x"}',
    "bob.json": '{"run": "a", "name": "bob", "hub": "tcp/127.0.0.1:1", "password": "x"}',
}


def png_without_palette() -> bytes:
    """A PNG picture whose pixels are indices of a palette that it lacks."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return len(data).to_bytes(4) + kind + data + zlib.crc32(kind + data).to_bytes(4)

    head = (10).to_bytes(4) + (10).to_bytes(4) + bytes([8, 3, 0, 0, 0])
    parts = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(110))) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A working folder with faulty files."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o600)  # others may not read credentials
    for name, shape, shade in (("small", (10, 10), 255), ("dark", (10, 10), 0), ("wide", (3, 2049), 255)):
        Image.fromarray(np.full(shape, shade, np.uint8)).save(tmp_path / f"{name}.png")
    room = np.zeros((10, 10), np.uint8)
    room[1:-1, 1:-1] = 255
    Image.fromarray(room).save(tmp_path / "room.png")
    Image.new("RGBA", (10, 10), (0, 0, 0, 0)).save(tmp_path / "clear.PNG")
    Image.new("L", (10, 10), 255).save(tmp_path / "plan.jpg")
    (tmp_path / "palette.png").write_bytes(png_without_palette())
    Credential("a", "r0", "tcp/127.0.0.1:1", "x").write(tmp_path / "r0.json")
    monkeypatch.chdir(tmp_path)
    yield tmp_path


def contents(folder: Path) -> dict[str, int]:
    return {str(path.relative_to(folder)): path.stat().st_mtime_ns for path in folder.rglob("*")}


EXPLORE = {
    "--map missing.yaml": "missing.yaml: no such file, neither here nor in the directory that the environment",
    "--map missing.png --resolution 0.1": "missing.png: no such file, neither here nor in",
    "--map small": "unknown map 'small'; did you mean the file small.yaml?",
    "--map broken.yaml": "broken.yaml: is not YAML",
    "--map list.yaml": "list.yaml: contains no `key: value` lines; a map_server YAML file names image, resolution",
    "--map no-resolution.yaml": "no-resolution.yaml: resolution is missing",
    "--map no-picture.yaml": "none.png: cannot be read (No such file or directory); a map's picture must be a PGM or",
    "--map no-image.yaml": "text.png: is not a complete PGM or PNG picture",
    "--map dark.yaml": "dark.yaml: no cell is free; check negate and the thresholds",
    "--map wide.yaml": f"wide.png: is 2049 x 3 cells, and the maximum is {MAX_SIDE} x {MAX_SIDE}",
    "--map turned.yaml": "turned.yaml: origin is rotated by 1.0 rad; rotate the picture instead",
    "--map small.png": "an image has no resolution: give --resolution METERS (per cell), or the YAML",
    "--map plan.jpg --resolution 0.1": "map = 'plan.jpg': a map is a PNG or PGM image, or a YAML file; save the",
    "--map clear.PNG --resolution 0.1": "clear.PNG: no cell is free; check negate and the thresholds, or draw free "
    "space in white (transparent pixels count as dark)",
    "small.yaml": "scenario small.yaml: is a map, not a scenario; give it as --map small.yaml",
    "office-plain": "scenario office-plain: is a map, not a scenario; give it as --map office-plain",
    "\u2013robots 3": "'\u2013robots' begins with a dash; type it with hyphens, as --robots",
    "--strategy test:Test": "strategy 'test:Test': test has no Test; no strategy is in <module 'test' from ",
    "--map small.yaml --resolution 0.1": "resolution = 0.1: small.yaml itself gives the size of its cells",
    "--map text.png --resolution 0.1": "text.png: is not a complete PGM or PNG picture",
    "--set robtos=3": "robtos: unknown setting; did you mean robots or robot or options?",
    "--set polygons.lasy=true": "polygons.lasy: unknown setting; did you mean lazy?",
    "--set robots=3 --robots 4": "set = 'robots=...': --robots is given, too; remove one of them",
    "--set radius": "set = 'radius': must be NAME=VALUE, as radius=0.2",
    "--set robot=3": "robot = 3: must be tables, [[robot]], of robot, sensor_range, field_of_view, speed,",
    "--map offise": "unknown map 'offise'; did you mean office? There are: unstructured, mixed, office,",
    "--map room.bmp": "unknown map 'room.bmp'; there are: unstructured, mixed, office,",
    "--map full": "map = 'full': is a directory; give the YAML file of a map in it",
    "--map em --resolution 0.0001": "width_m is 21.0 m; with cells of 0.0001 m it could be at most 0.2048 m",
    "--set polygons=3": "polygons = 3: must be a table",
    "--set map_options=3": "map_options = 3: must be a table",
    "--strategy own:": "strategy 'own:': must be package.module:Class",
    "--range -3": "range = '-3': must be a distance of 0 or more: meters, as 12.5, or a share of the diagonal",
    "--range nan": "range = 'nan': must be a distance",
    "--strategy leaders --range 3": "range = '3': leaders needs rho_lead <= range, not rho_lead = 4 m with",
    "--strategy leaders --range 5%": "range = '5%': leaders needs rho_lead <= range, not rho_lead = 4 m with a",
    "--strategy leaders --range 5 --option rho_lead=6": "not rho_lead = 6 m with a range of 5 m: no robot follows",
    "--range -5%": "range = '-5%': must be a distance",
    "--range far": "range = 'far': must be a distance",
    "--robots 0": "robots = 0: must be greater than or equal to 1",
    "--robots 65 --map-encoding polygons": "robots = 65: packets can address the maps of 64 robots",
    "--robots three": "Invalid value for '--robots'",
    "--robots 30 --map small.yaml": "16 free cells lie 3 cells apart around (3, 6); name fewer robots, or a smaller",
    "--strategy best": "no strategy is called 'best'; there are: burgard,",
    "robots=3": "no such file, and no shipped scenario",
    "--strategy agent.strategies.meier:Meyer": "agent.strategies.meier has no Meyer; did you mean Meier?",
    "--map-encoding radio": "map_encoding = 'radio': no map encoding is called 'radio'; there are: polygons,",
    "--dissemination never": "no dissemination is called 'never'; there are: backoff, thesis, gossip; or give",
    "--bus can": "bus = 'can': must be 'zenoh' or 'memory'",
    "--option beta": "option = 'beta': must be NAME=VALUE, as beta=0.5",
    "--option gamma=3": "repairmen has no option 'gamma'; there are: candidates,",
    "--option small_frontier=x": "option small_frontier of repairmen must be a number, not 'x'",
    "--option beta=NaN": "beta must lie between",
    "--bandwidth -1": "bandwidth = '-1': must be a whole number of bytes per step, 0 to",
    "--bandwidth 1kB": "bandwidth = '1kB': must be a whole number of bytes per step",
    "--bandwidth nan": "bandwidth = 'nan': must be a whole number of bytes per step",
    "--sensor-range 0.05": "sensor_range = 0.05 m of robot 0 is less than a cell of 0.1 m",
    "--sensor-range nan": "sensor_range = nan",
    "--speed 0": "speed = 0.0: must be greater than 0",
    "--speed nan": "speed = nan",
    "--steps 0": "steps = 0: must be greater than or equal to 1",
    "--seed -1": "seed = -1: must be greater than or equal to 0",
    "--start 0,0": "start on map office: 0,0 is not free: robots cannot start there; the nearest free point is",
    "--start -50,3": "-50,3 is outside the map, which extends from 0,0 to",
    "--start nan,1": "start.0 = nan",
    "--start 3": "start = '3': must be two numbers in meters, as 3.5,12",
    "--pace 0": "pace = 0: must be 0.5 steps per second or more",
    "--view-as hologram": "view-as = 'hologram': must be one of auto, native, web, file",
    "--out full": "out = full: already exists; name a new directory, or empty this one",
    "--out file": "out = file: already exists; name a new directory",
    "--out file/run": "out = file/run: cannot be made: Not a directory",
    "missing.toml": "scenario missing.toml: no such file, and no shipped scenario; there are: breakdown.toml,",
    "full": "scenario full: Is a directory",
    "broken.toml": "scenario broken.toml: not TOML: Invalid value (at line 1, column 10)",
    "unknown.toml": "scenario unknown.toml: robtos: unknown setting; did you mean robots or robot or options? There",
    "type.toml": "scenario type.toml: robots = 'three': must be a whole number",
    "table.toml": "robot.0.spede: unknown setting; did you mean speed? There are: robot, sensor_range,",
    "lasers.toml": "robot.0.laser.preset = 'lidar': did you mean rplidar-a1 or ideal? There are:",
    "lasers2.toml": "robot.0.laser.mising: unknown setting; did you mean missing?",
    "lasers3.toml": "missing = True: must be a number",
    "lasers4.toml": "robot.0.laser = 3: must be a table",
    "lasers5.toml": "[[robot]] names robot 3; the last one is 2",
    "lasers6.toml": "position_error_m = -1: must be 0 to 1 m",
    "fault.toml": "death of robot 5: the last robot is 1",
    "nan.toml": "scenario nan.toml: speed = nan",
    "option.toml": "repairmen has no option 'betta'; there are: candidates,",
    "polygon.toml": "medium_use = 0: must be above 0 and at most 100",
    "wide.toml": "start on map room: no cell is free for robots of that radius",
    "wall.toml": "start on map room: 0.05,0.05 is not free: robots cannot start there; the nearest free point is 0.15",
    "blind.toml": "sensor_range = 0.01 m of robot 1 is less than a cell of 0.1 m",
    "deep.toml": "scenario deep.toml: is nested too deeply",
    "/dev/zero": "scenario /dev/zero: is a device, not a file",
    "--map deep.yaml": "deep.yaml: is nested too deeply; a map_server YAML file has `key: value` lines",
    "--map endless.yaml": "/dev/zero: cannot be read (is a device, not a file); a map's picture must be a PGM",
    "--map coarse.yaml": "resolution is 900000.0, not a number of meters per cell above 0, 1000 at most",
    "--map afar.yaml": "origin is [1e+308, 0.0, 0.0], not three numbers of 1e+08 at most",
    f"--set options={5000 * '[' + 5000 * ']'}": "set = 'options=...': nested too deeply",
    "--set radius=1e6 --set sensor_range=1e6": "radius = 1e+06 m: exceeds the largest map with cells of 0.1 m",
    "--unknown-flag": "No such option: --unknown-flag",
    "afar.toml": "change.0.range = 1e+300: must be a distance of 0 or more: meters, as 12.5, or a share of the",
    "preset.toml": "radio.preset = ['wifi']: must be one name",
    "reuse.toml": "reuse = 'yes': must be true or false",
    f"--set radio.delay={400 * '9'}": "999: must lie between -2147483647 and 2147483647",
    f"--set laser.beams={400 * '9'}": "999: must lie between -2147483647 and 2147483647",
    "--set laser.missing=NaN": "missing = nan: must be 0 to 1",
    "--set laser.range_error_m=Infinity": "range_error_m = inf: must be 0 to 1 m",
    "--set laser.short=[0.1]": "short = [0.1]: must be a number",
    "--set laser.noise=1": "laser.noise: unknown setting; there are: preset, range_error_m,",
    "--set pose.preset=[]": "pose.preset = []: there are: exact, graph-slam,",
    "--set pose.heading_error_deg=1e300": "heading_error_deg = 1e+300: must be 0 to 10 degrees",
    "--set pose=slam": "pose.preset = 'slam': there are: exact, graph-slam, particle-filter",
    "--set pose=3": "pose = 3: must be a table of preset, position_error_m",
    "--set laser.preset=[]": "laser.preset = []: there are: ideal, sick-lms,",
    "--set laser.preset=ideal --laser sick-lms": "set = 'laser.preset=...': --laser is given, too; remove one",
    "--laser sick": "laser.preset = 'sick': did you mean sick-lms?",
    "groups.toml": "groups = '0': must be a whole number",
    "share.toml": "min_coverage = True: must be a number",
    "digits.toml": "scenario digits.toml: not TOML: Exceeds the limit",
    "--map palette.yaml": "palette.png: is not a complete PGM or PNG picture",
    "--map bomb.yaml": "bomb.yaml: is not YAML",
    "--map date.yaml": "date.yaml: is not YAML",
    "--map em --set map_options.seed=3": "map_options: name and seed are the settings map and map_seed",
    f"--map {300 * 'a'}": "File name too long" if sys.version_info < (3, 14) else "unknown map 'aaa",
    "--hosts hosts.toml": "hosts hosts.toml: host.0.robots = 999999999999999999999999: must be a number of robots",
}

OTHERS = {
    "map make castle": "unknown map 'castle'; there are",
    "map make em --seed -1": "Invalid value for '--seed'",
    "map make em --out em.png": "out = em.png: must end in .yaml",
    "map make em --out nowhere/em.yaml": "No such file or directory",
    "map make caves --option clutter=21": "clutter is 21; it must be 0 to 20 rocks per 100 square meters",
    "map make caves --option width_m=x": "option = 'width_m=x': must be a number",
    "map make caves --option rooms=3": "caves has no parameter 'rooms'; it has width_m, height_m",
    "map show caves --option clutter": "option = 'clutter': must be NAME=VALUE, as width_m=60",
    "map show caves --option seed=3": "option = 'seed=...': use --seed",
    "map show missing.yaml": "missing.yaml: no such file",
    "merge file file --out joined": "file: is a file; name record directories of robots in the field (docs/",
    "map show em --png nowhere/em.png": "png = nowhere/em.png: no such folder: nowhere",
    "map show em --png em.xyz": "png = em.xyz: must end in .png",
    "new strategy test": "name = 'test': would hide the Python module of this name",
    "new strategy numpy": "name = 'numpy': would hide the Python module of this name",
    "compare --strategies meier,meier": "two of the scenarios are the same: strategy = meier",
    "compare --strategies meier,": "there is nothing to compare: give at least two scenarios",
    "compare --strategies ,": "strategies = ',': is empty; give values separated by commas, or omit --strategies",
    "compare --strategies meier,nope": "no strategy is called 'nope'",
    "compare --strategies meier,nearest --map room.yaml --out file": "file: cannot be created (File exists)",
    "size --set robots=3": "set = 'robots=...': use the flag of this command",
    "compare --strategies meier,nearest --set seed=3": "set = 'seed=...': use the flag of this command",
    "size --robots 0..2": "robots = 0: must be greater than or equal to 1",
    "sweep lossy.toml --scheduler foo": "scheduler = 'foo': must be its address, as tcp://10.0.0.1:8786",
    "sweep lossy.toml --plot nowhere/x.png": "plot = nowhere/x.png: no such folder: nowhere",
    "sweep lossy.toml --out runs.csv": "out = runs.csv: must end in .parquet",
    "chaos --out file": "out = file: is a file; name a directory for the scenarios of failing cases",
    "sweep lossy.toml --table x.txt": "table = x.txt: must end in .csv or .parquet",
    "sweep kinds.toml --seeds 2 --test-seeds 2": "--seeds and --test-seeds: give only one of them",
    "tune repairmen --seeds 1000..1002": "seed 1000: is a test seed, on which nothing may be tuned; use training seeds",
    "tune repairmen --check-seeds 5,1003": "seed 1003: is a test seed",
    "tune repairmen --seeds x": "seeds = 'x': must be whole numbers of at most 100000, as 2..8 or 2,4,8",
    "tune repairmen --weights beta": "repairmen has no weight 'beta'; there are: small_frontier",
    "tune repairmen --set seed=1003": "seed = 1003: is chosen by the search; remove it",
    "tune repairmen --maps nope": "unknown map 'nope'",
    "replay missing": "missing: not a run directory: scenario.toml is missing",
    "replay half": "half: no readable summary.json",
    "report killed": "killed: no readable summary.json: the run has not ended, or was killed; to repeat it:",
    "replay other": "other: summary.json is not the summary of a run: it lacks finished, reason, steps,",
    "replay whole": "whole: summary.json is not the summary of a run: it lacks finished, reason, steps,",
    "replay whole --bus can": "bus = 'can': must be 'zenoh' or 'memory'",
    "report full": "full: not a run directory: scenario.toml is missing",
    "export full --mcap": "full: not a run directory: scenario.toml is missing",
    "watch full": "full: no recording (run.rrd), and no run in progress",
    "capture missing": "missing: No such file or directory; name the directory of a run, or a capture",
    "report [/x]": "[/x]: not a run directory: scenario.toml is missing",
    "capture torn.pcapng": "torn.pcapng: not a pcapng file",
    "capture torn.pcapng --json": "torn.pcapng: not a pcapng file",
    "capture whole --robot 1": "robot = 1: must be at most 0",
    "capture": "name a run directory, or use --install-dissector",
    "capture full --kind x": "kind = 'x': there are ins, rep, del,",
    "capture full --step x": "step = 'x': must be a step, as 12, or steps, as 10-20",
    "capture full --step 5-2": "step = '5-2': the first step must not exceed the last, as in 10-20",
    "sweep missing.toml": "experiment missing.toml: no such file, and no shipped experiment; there are:",
    "sweep broken.toml": "experiment broken.toml: not TOML",
    "strategy": "no such command: 'strategy'; did you mean strategies? There are: explore, play, watch",
    "strategies burgart": "no strategy is called 'burgart'; did you mean burgard or burgard-optimal?",
    "bench speed": "no benchmark is called 'speed'; there are: kernels, swarm, replanning",
    "run agent": "Missing option '--credential'",
    "run agent --credential missing.json": "credential missing.json: No such file or directory",
    "run agent --credential broken.json": "credential broken.json: not JSON",
    "run agent --credential list.json": "credential list.json: needs the strings run, name, hub, password",
    "run agent --credential short.json": "credential short.json: needs the strings run, name, hub, password",
    "run agent --credential nowhere.json": "hub = 'the hub': must be as tcp/127.0.0.1:7447",
    "run agent --credential deep.json": "credential deep.json: not JSON",
    "run agent --credential star.json": "a run cannot be called 'a*': use letters, digits",
    "run agent --credential port.json": "hub = 'tcp/127.0.0.1:99999': must be as tcp/127.0.0.1:7447",
    "run netshaper --listen 127.0.0.1:٣": "with a port from 1 to 65535",
    "run agent --credential bob.json": "'bob' is not the name of a robot",
    "run worldsim --credential r0.json": "credential r0.json is that of r0; world.json is needed here",
    "run recorder --credential r0.json": "credential r0.json is that of r0; recorder.json is needed here",
    "run view --credential r0.json": "credential r0.json is that of r0; view.json is needed here",
    "run netshaper --listen here": "listen = 'here': must be HOST:PORT, as 127.0.0.1:7447 or [::1]:7447, with",
    "run netshaper --listen 127.0.0.1:0": "listen = '127.0.0.1:0': must be HOST:PORT, as 127.0.0.1:7447",
    "run netshaper --listen ::1:7447": "listen = '::1:7447': must be HOST:PORT, as 127.0.0.1:7447 or [::1]:7447",
    "keys k --router 0,1": "router = '0,1': must be NAME=0,1,..., as rack-1=0,1",
    "keys k --router a=0,3": "router = a=0,3: r3 must be one of the 3 robots, and behind one router",
    "keys k --router a=0,1 --router b=1": "router = a=0,1 b=1: r1 must be one of the 3 robots, and behind one",
    "run netshaper --listen 127.0.0.1:65536": "with a port from 1 to 65535",
    "run netshaper --listen 0.0.0.0:7447": "listen = '0.0.0.0:7447': 0.0.0.0 cannot be reached from other hosts",
    "run netshaper --listen [::]:7447": "give one by which others know this host",
    "run netshaper --credentials full": "credentials = full: it exists already; name a new directory",
    "run netshaper --credentials file": "credentials = file: it exists already; name a new directory",
    "sweep seeds.toml": "experiment seeds.toml: seeds = 1000000000000: must be less than or equal to 100000",
    "sweep runs.toml": "experiment runs.toml: 400000 runs: must be at most 100000",
    "sweep lossy.toml --seeds 1000000000000": "Invalid value for '--seeds': Input should be less than or equal to 1",
    "size --robots 1..100000": "robots = '1..100000': must be whole numbers of at most 256, as 2..8 or 2,4,8",
    "size --robots 1..1000000000000": "must be whole numbers of at most 256",
    "fly": "no such command: 'fly'; there are: explore",
}


@pytest.mark.parametrize("words", [f"explore {words}" for words in EXPLORE] + list(OTHERS))
def test_bad_input_is_explained_and_writes_no_file(desk: Path, words: str) -> None:
    complaint = OTHERS.get(words) or EXPLORE[words.removeprefix("explore ")]
    before = contents(desk)
    result = murmur(*words.split())
    output = result.stderr.replace("\n", " ")
    assert result.exit_code == BAD_INPUT, output
    assert complaint in output
    assert "Traceback" not in output
    assert output.startswith(("murmur: ", "Usage: "))
    assert contents(desk) == before


@pytest.mark.parametrize("kind", ["pipe", "directory"])
@pytest.mark.parametrize(
    "words",
    [
        "explore it.toml", "explore --map it.yaml", "explore --map it.png --resolution 1", "explore --hosts it.toml",
        "explore --map pictured.yaml", "sweep it.toml", "sweep lossy.toml --out it.parquet",
        "run agent --credential it.json", "capture it.pcapng", "capture run", "replay run", "report run",
    ],
)  # fmt: skip
def test_pipes_and_directories_are_no_input_files(desk: Path, words: str, kind: str) -> None:
    """A pipe without a writer must not be opened: it would never answer."""
    make = os.mkfifo if kind == "pipe" else os.mkdir
    (desk / "run").mkdir()
    (desk / "run" / "scenario.toml").write_text(FILES["whole/scenario.toml"])
    (desk / "pictured.yaml").write_text(YAML.format(image="it.png"))
    for suffix in ("toml", "yaml", "png", "parquet", "json", "pcapng"):
        make(desk / f"it.{suffix}")
    for name in ("summary.json", "radio.pcapng"):
        make(desk / "run" / name)
    before = contents(desk)
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    signal.alarm(20)
    try:
        result = murmur(*words.split())
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
    assert result.exit_code == BAD_INPUT, result.output
    assert "is a pipe, not a file" in result.stderr or kind == "directory"
    assert "irectory" in result.stderr or kind == "pipe"
    assert contents(desk).keys() - before.keys() <= {".it.parquet.lock"}


def test_a_name_that_is_not_utf_8_is_refused_before_anything_is_written(desk: Path) -> None:
    name = os.fsdecode(b"gr\xfcn")
    result = murmur("explore", "--map", "room.yaml", "--robots", "1", "--bus", "memory", "--out", name)
    assert result.exit_code == 2
    assert result.stderr.startswith("murmur: out = 'gr\\udcfcn': not UTF-8; ")
    assert not (desk / name).exists()


def test_a_compiler_that_is_turned_off_is_reported(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    before = contents(desk)
    result = murmur("explore", "--map", "room.yaml", "--robots", "1", "--bus", "memory", "--steps", "1")
    assert result.exit_code == BAD_INPUT
    assert "NUMBA_DISABLE_JIT is set, but kernels must be compiled: unset this" in result.stderr
    assert contents(desk) == before


def test_a_scenario_may_begin_with_a_byte_order_mark(desk: Path) -> None:
    (desk / "mark.toml").write_bytes(
        b"\xef\xbb\xbf" + b'map = "room.yaml"\nrobots = 1\nsteps = 1\nbus = "memory"\n'
    )
    assert murmur("explore", "mark.toml", "--sensor-range", "1", "--out", "[/x]").exit_code in (0, 1)
    assert (desk / "[/x]" / "summary.json").exists()


def test_all_errors_are_reported_at_once(desk: Path) -> None:
    result = murmur("explore", "--robots", "0", "--speed", "-1", "--map-encoding", "x")
    assert result.exit_code == BAD_INPUT
    assert [line.split(" = ")[0] for line in result.stderr.splitlines()] == [
        f"murmur: scenario: {key}" for key in ("robots", "speed", "map_encoding")
    ]


def test_errors_do_not_go_to_standard_output(desk: Path) -> None:
    for words in (
        ["explore", "--json", "--range", "-3"],
        ["replay", "--json", "full"],
        ["bench", "x", "--json"],
        ["capture", "torn.pcapng"],
        ["capture", "torn.pcapng", "--json"],
    ):
        result = murmur(*words)
        assert (result.exit_code, result.stdout) == (BAD_INPUT, "")


def test_the_traceback_of_an_input_error_is_printed_on_request(
    desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MURMUR_TRACEBACK", "1")
    result = murmur("explore", "missing.toml")
    assert result.exit_code == BAD_INPUT
    assert result.stderr.startswith("Traceback")
    assert "murmur: scenario missing.toml: no such file" in result.stderr


def test_bad_input_ends_the_installed_command(desk: Path) -> None:
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


def test_a_file_with_the_name_of_the_runs_folder_is_reported(desk: Path) -> None:
    (desk / "runs").write_text("x")
    result = murmur("explore", "--map", "room.yaml", "--robots", "1", "--bus", "memory")
    assert result.exit_code == BAD_INPUT
    assert "runs is a file, and runs go into a directory of that name: move it, or use --out" in result.stderr
