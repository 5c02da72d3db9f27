"""Films of a run directory: one frame per step, in formats that other programs can read."""

from __future__ import annotations

import shutil
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageDraw
from typer.testing import CliRunner

from deploy.after import archive
from deploy.after.frames import VEIL, Frames, side_by_side
from deploy.after.movie import MP4, MovieError, write_movie
from deploy.commands.app import app
from deploy.record.colors import GREY, PAPER, SIGNAL, Color, mix, robot_color
from deploy.run.exploration import explore
from deploy.scenario.scenario import parse
from protocol.grid import FREE, UNKNOWN
from protocol.packages import MissingPackageError
from tests.deploy.small_run import hall, small_directory
from worldsim.maps import to_world

ffmpeg = pytest.importorskip(
    "imageio_ffmpeg", reason="imageio-ffmpeg is not installed: pip install 'murmur-robots[film]'"
)


@cache
def frames() -> Frames:
    run = archive.read(small_directory())
    return Frames(run)


def count(picture: Image.Image, color: Color, off: int = 0) -> int:
    pixels = np.asarray(picture).reshape(-1, 3).astype(int)
    return int((np.abs(pixels - color).max(axis=1) <= off).sum())


def test_a_frame_grays_cells_that_no_robot_knows_and_shows_every_robot() -> None:
    run = archive.read(small_directory())
    picture = frames().at(40)
    assert picture.size == frames().size
    grids = [run.maps.planning(robot, 40) for robot in range(3)]
    known = np.logical_or.reduce([grid != UNKNOWN for grid in grids if grid is not None])
    hidden = int((~known & (run.plan.map.cells == FREE)).sum())
    (wide, _), world = frames()._world_size, run.plan.map
    veiled = count(picture, mix(PAPER, GREY, VEIL), 2)
    assert veiled == pytest.approx(hidden * (wide / world.width) ** 2, rel=0.15)
    assert count(frames().at(1), mix(PAPER, GREY, VEIL), 2) > veiled
    for robot in range(3):
        assert count(picture, robot_color(robot)) > 100


def test_frames_differ_between_steps_and_repeat_after_the_end() -> None:
    first, later, last = (frames().at(step).tobytes() for step in (1, 20, 40))
    assert len({first, later, last}) == 3
    assert frames().at(99).tobytes() == last


def drawn_texts(shown: Frames, step: int, monkeypatch: pytest.MonkeyPatch) -> dict[str, tuple[float, ...]]:
    """The texts of a frame with their boxes, without the numbers on the robots."""
    boxes: dict[str, tuple[float, ...]] = {}
    write = ImageDraw.ImageDraw.text

    def noted(self: Any, place: Any, text: str, fill: Any, letters: Any, anchor: str) -> None:
        if anchor != "mm":
            boxes[f"{text} at {place}"] = self.textbbox(place, text, letters, anchor)
        write(self, place, text, fill, letters, anchor)

    monkeypatch.setattr(ImageDraw.ImageDraw, "text", noted)
    shown.at(step)
    monkeypatch.undo()
    return boxes


@pytest.mark.parametrize("width", [560, 840, 960, 1120, 1280])
def test_no_text_of_a_frame_is_cut_or_covers_another(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = Frames(archive.read(small_directory()), width)
    boxes = drawn_texts(shown, 40, monkeypatch)
    for text, (left, top, right, bottom) in boxes.items():
        assert 0 <= left < right <= shown.size[0], text
        assert 0 <= top < bottom <= shown.size[1], text
    for (one, a), (other, b) in combinations(boxes.items(), 2):
        apart = a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]
        assert apart, f"{one} covers {other}"


def test_a_frame_has_axes_a_scale_bar_a_legend_and_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    texts = [each.split(" at ")[0] for each in drawn_texts(frames(), 30, monkeypatch)]
    assert "step 30 of 40, 30 s" in texts
    assert {"0", "5", "10", "15", "20", "25 m"} <= set(texts)
    assert {"5 m", "unknown", "free", "wall", "received data", "in range", "target"} <= set(texts)


def test_links_of_a_frame_are_those_that_carried_data_also_by_broadcast(tmp_path: Path) -> None:
    from deploy.run.exploration import explore
    from deploy.scenario.scenario import parse

    explore(parse({"robots": 3, "range": "100%", "steps": 12, "bus": "memory"}), out=tmp_path / "run")
    run = archive.read(tmp_path / "run")
    assert len(run.links[10]) > 2
    assert count(Frames(run).at(10), SIGNAL, 30) > 20
    assert run.in_range(10) == {(0, 1), (0, 2), (1, 2)}
    (tmp_path / "run" / "radio.pcapng").unlink()
    without = archive.read(tmp_path / "run")
    assert without.links[10] <= run.links[10]


def test_a_robot_on_a_border_is_in_the_cell_after_it_as_for_the_relay() -> None:
    """With a range of eight cells, a robot in cell 10 receives those in cell 18, and none in cell 19 or 20."""
    made = archive.read(small_directory())
    world = made.plan.map
    run = replace(made, plan=replace(made.plan, range_m=8 * world.resolution))
    for cell, is_near in ((18.49, True), (18.5, False), (19.0, False), (19.5, False)):
        for here, there in (((10, 10), (cell, 10)), ((10, 10), (10, cell))):
            x, y = zip(*(to_world(world, *each) for each in (here, there)), strict=True)
            vars(run)["steps"] = {
                "step": np.array([1, 1]), "robot": np.array([0, 1]), "x": np.array(x), "y": np.array(y)
            }  # fmt: skip
            assert run.in_range(1) == ({(0, 1)} if is_near else set()), (cell, there)


def test_many_robots_and_a_flat_building_fit_into_a_frame(tmp_path: Path) -> None:
    from deploy.run.exploration import explore
    from deploy.scenario.scenario import parse

    crowd = {"map": "burgard-corridor", "robots": 23, "steps": 6, "bus": "memory", "map_encoding": "none"}
    explore(parse(crowd), out=tmp_path / "run")
    run = archive.read(tmp_path / "run")
    shown = Frames(run, 641)
    assert shown.size[0] == 640
    assert all(side % 2 == 0 for side in shown.size)
    right = max(left for left, _ in shown._thumbs_at) + shown._panel_width
    below = (
        max(top for _, top in shown._thumbs_at)
        + shown._panel_width * run.plan.map.height / run.plan.map.width
    )
    assert right <= shown.size[0]
    assert below <= shown._charts_top
    pair = side_by_side([shown, frames()], 3)
    assert pair.size == (640 + 1280, max(shown.size[1], frames().size[1]))


@pytest.mark.parametrize("runs", [1, 2])
def test_a_film_has_a_picture_for_each_step(runs: int, tmp_path: Path) -> None:
    path = write_movie([small_directory()] * runs, MP4, tmp_path / "film", rate=20)
    assert path == tmp_path / "film.mp4"
    number, seconds = ffmpeg.count_frames_and_secs(path)
    assert number == 40 + 2 * 20
    assert seconds == pytest.approx(80 / 20)
    reader = ffmpeg.read_frames(path)
    map_id = next(reader)
    wide, tall = map_id["size"]
    shown = np.frombuffer(next(reader), np.uint8).reshape(tall, wide, 3).astype(int)
    reader.close()
    if runs == 1:
        assert np.abs(shown - np.asarray(frames().at(1))).mean() < 3
    assert list(tmp_path.iterdir()) == [path]


def test_a_film_of_two_runs_has_the_name_of_the_second_also_if_that_is_the_current_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    for copy in (first, second):
        shutil.copytree(small_directory(), copy)
    monkeypatch.chdir(second)
    assert write_movie([first, Path()], MP4, rate=1) == first / "movie-second.mp4"


def test_the_command_writes_a_gif_and_prints_its_name(tmp_path: Path) -> None:
    out = tmp_path / "film.gif"
    done = CliRunner().invoke(app, ["movie", str(small_directory()), "--gif", "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith(f"{out}: ")
    with Image.open(out) as film:
        assert film.size == (960, frames().size[1] * 960 // 1280 // 2 * 2)
        assert film.n_frames >= 40  # type: ignore[attr-defined]
        assert film.info["loop"] == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["movie", "RUN", "--mp4", "--gif"], "use either --mp4 or --gif"),
        (["movie", "RUN", "RUN", "RUN"], "movie takes one run directory, or two"),
        (["movie", "RUN", "--rate", "0"], "rate = 0: must be 0.1 to 120 steps per second"),
        (["movie", "RUN", "--rate", "120.5"], "rate = 120.5: must be 0.1 to 120 steps per second"),
        (["movie", "/nowhere"], "/nowhere: not a run directory: scenario.toml is missing"),
        (
            ["movie", "RUN", "--rate", "120", "--out", "/nowhere/film.mp4"],
            "out = /nowhere/film.mp4: no such folder: /nowhere",
        ),
        (
            ["movie", "RUN", "--out", "film.avi"],
            "out = film.avi: must end in .mp4; --mp4 and --gif choose the format",
        ),
        (["report", "RUN", "RUN", "RUN"], "report takes one run directory, or two"),
    ],
)
def test_invalid_requests_for_films_are_refused(arguments: list[str], message: str) -> None:
    run = str(small_directory())
    done = CliRunner().invoke(app, [word.replace("RUN", run) for word in arguments])
    assert (done.exit_code, done.stderr) == (2, f"murmur: {message}\n")


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(MissingPackageError, match=r"pip install 'murmur-robots\[film\]'"):
        write_movie([Path()], MP4)


def test_the_error_of_ffmpeg_is_quoted_and_no_file_remains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("deploy.after.movie.AS_MP4", ["-c:v", "no-such-codec"])
    with pytest.raises(MovieError, match=r"film\.mp4: ffmpeg failed: .*"):
        write_movie([small_directory()], MP4, tmp_path / "film.mp4")
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_an_error_of_the_disk_and_no_film_remains(tmp_path: Path) -> None:
    """ffmpeg writes to a device without space instead of the temporary file."""
    (tmp_path / ".film.part.mp4").symlink_to("/dev/full")
    done = CliRunner().invoke(app, ["movie", str(small_directory()), "--out", str(tmp_path / "film.mp4")])
    assert (done.exit_code, list(tmp_path.iterdir())) == (3, [])
    assert done.stderr.endswith(f"murmur: {tmp_path / 'film.mp4'}: No space left on device\n")


def test_texts_of_narrow_maps_with_long_names_do_not_overlap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = hall(tmp_path / f"{'the-plan-of-the-east-wing-' * 6}.png", 500, 40)
    explore(parse(settings | {"robots": 2, "steps": 2}), out=tmp_path / "run")
    boxes: list[tuple[float, float, float, float]] = []
    write = ImageDraw.ImageDraw.text

    def note(self: ImageDraw.ImageDraw, xy: Any, text: str, fill: Any, letters: Any, anchor: str) -> None:
        if self.mode == "RGB":
            boxes.append(self.textbbox(xy, text, letters, anchor))
        write(self, xy, text, fill, letters, anchor)

    monkeypatch.setattr(ImageDraw.ImageDraw, "text", note)
    width = Frames(archive.read(tmp_path / "run")).at(2).width
    assert boxes
    assert all(0 <= left < right <= width for left, _, right, _ in boxes)
    for one, other in combinations(boxes, 2):
        assert one[2] <= other[0] or other[2] <= one[0] or one[3] <= other[1] or other[3] <= one[1]


def test_the_axis_of_the_explored_share_ends_at_the_whole(tmp_path: Path) -> None:
    explore(parse({"robots": 1, "steps": 1, "bus": "memory", "map": "office"}), out=tmp_path / "run")
    run = Frames(archive.read(tmp_path / "run"))
    whole, at_end = (np.asarray(run.at(step)) for step in (1, 2))
    assert (whole == at_end).all()
    charts, spans = run._charts
    assert all(right - left > 100 for left, right, *_ in spans)
    left, right, top, bottom = map(round, spans[0])
    dot = np.asarray(charts)[top:bottom, left:right]
    rows = np.flatnonzero((np.abs(dot.astype(int) - robot_color(0)).max(axis=2) < 3).any(axis=1))
    assert len(rows) and rows.min() > 0.85 * (bottom - top), "6 % are drawn near the lower end"
