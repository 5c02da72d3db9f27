"""`murmur map`: maps are made, shown and explored."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from deploy.commands.console import screen
from tests.deploy.commands.office_floor import explore, murmur
from worldsim import generators


def test_maps_can_be_made_shown_and_explored(floor: str) -> None:
    assert murmur("map", "make", "em", "--out", "hall.yaml").stdout.startswith("hall.yaml: 21 x 24 m")
    shown = murmur("map", "show", "hall.yaml", "--png", "hall.png.png")
    assert "hall: 420 x 480 cells of 0.05 m" in shown.stdout
    assert {"█", " "} <= set(shown.stdout), "walls and rooms are distinguishable without colors"
    assert Path("hall.png.png").exists()
    assert explore("hall.yaml", "--steps", "2").exit_code == 1
    drawing = murmur("map", "show", "office").stdout.split("\n\n")[0].splitlines()
    assert set(drawing[0] + drawing[-1]) <= set("█▀▄"), "the walls all around are there, whatever the scale"
    assert {line[0] + line[-1] for line in drawing} == {"██"}
    listed = murmur("map", "list").stdout
    assert all(name in listed for name in generators.names())


@pytest.mark.parametrize("family", ["map", "radio"])
def test_lists_are_wrapped_beside_the_names_on_a_terminal_only(
    family: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    piped = murmur(family, "list").stdout
    monkeypatch.setattr(screen, "_force_terminal", True)
    monkeypatch.setattr(screen, "_width", 80)
    monkeypatch.setattr(screen, "_color_system", None)
    shown = murmur(family, "list").stdout
    assert shown.split() == piped.split()
    assert max(map(len, piped.splitlines())) > 80, "a line each, for grep"
    assert max(map(len, shown.splitlines())) <= 80
    names = [line.split()[0] for line in piped.splitlines()]
    assert [line.split()[0] for line in shown.splitlines() if not line.startswith(" ")] == names


def test_the_size_of_a_picture_is_printed_because_its_resolution_may_be_in_a_wrong_unit(floor: str) -> None:
    murmur("map", "make", "em", "--out", "hall.yaml")
    explored = explore("hall.png", "--resolution", "0.1", "--steps", "1")
    assert explored.stderr.startswith("map: 420 x 480 cells of 0.1 m, 42.0 x 48.0 m\n")


def test_size_and_clutter_of_a_map_are_options(floor: str) -> None:
    murmur("map", "make", "caves", "--seed", "3", "--option", "width_m=20", "--option", "height_m=16")
    words = ["--seed", "3", "--option", "width_m=20", "--option", "height_m=16"]
    assert "caves: 200 x 160 cells of 0.1 m" in murmur("map", "show", "caves.yaml").stdout
    assert "caves: 200 x 160 cells of 0.1 m" in murmur("map", "show", "caves", *words).stdout
    plain, full = (murmur("map", "show", "caves", *words, "--option", f"clutter={n}").stdout for n in (0, 9))
    assert plain != full


@pytest.mark.parametrize(
    ("encoding", "wall"), [("latin-1", b"#"), ("ascii", b"#"), ("utf-8", "\u2588".encode())]
)
def test_a_map_is_drawn_in_characters_that_the_output_has(encoding: str, wall: bytes) -> None:
    command = [sys.executable, "-m", "deploy.commands.main", "map", "show", "leader-rooms"]
    done = subprocess.run(
        command, env=os.environ | {"PYTHONIOENCODING": encoding}, capture_output=True, check=True
    )
    assert done.stdout.startswith(wall) and b"?" not in done.stdout


def test_output_replaces_characters_that_its_encoding_lacks(tmp_path: Path) -> None:
    plan = tmp_path / "b\u00fcro.png"
    Image.fromarray(np.full((40, 40), 255, np.uint8)).save(plan)
    command = [sys.executable, "-m", "deploy.commands.main", "map", "show", str(plan), "--resolution", "0.1"]
    done = subprocess.run(
        command, env=os.environ | {"PYTHONIOENCODING": "ascii"}, capture_output=True, check=True
    )
    assert b"b?ro: 40 x 40 cells" in done.stdout


def test_the_coverage_of_a_picture_needs_its_resolution(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Image.fromarray(np.full((40, 40), 255, np.uint8)).save("plan.png")
    refused = murmur("radio", "coverage", "ble", "--map", "plan.png")
    assert refused.exit_code == 2 and "--resolution" in refused.stderr
    assert murmur("radio", "coverage", "ble", "--map", "plan.png", "--resolution", "0.1").exit_code == 0
