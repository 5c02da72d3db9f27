"""Figures and the page of a run show the data of its directory."""

from __future__ import annotations

import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from matplotlib.axes import Axes
from PIL import Image
from typer.testing import CliRunner

from agent.planning.path_planner import PathPlanner
from agent.strategies.base import Situation
from agent.strategies.targets import TargetStrategy
from deploy.after import archive, report
from deploy.after.figures import channel_load
from deploy.after.frames import Frames
from deploy.after.report import write_report
from deploy.commands.app import app
from deploy.record import run_directory
from deploy.record.map_history import MAP_CHANGES, OUTLINES
from deploy.run.exploration import explore
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import parse
from protocol.arrays import Cells
from tests.deploy.small_run import SETTINGS, small_directory, small_run

FIGURES = ["approximation.png", "channel-load.png", "maps-over-time.png"]


class Page(HTMLParser):
    """The page's words, and all that it would fetch."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.words = ""
        self.sources: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in ("img", "meta", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words += data + " "


@pytest.fixture(autouse=True)
def few_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "MOST_FRAMES", 3)


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    copy = tmp_path / "run"
    shutil.copytree(small_directory(), copy)
    return copy


def test_all_figures_of_a_run_are_drawn() -> None:
    folder = small_directory() / run_directory.PICTURES
    assert sorted(path.name for path in folder.iterdir()) == FIGURES
    for name in FIGURES:
        assert min(Image.open(folder / name).size) > 500


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    copy = tmp_path_factory.mktemp("report") / "run"
    shutil.copytree(small_directory(), copy)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "MOST_FRAMES", 40)
        return write_report(copy)


def test_a_page_embeds_all_pictures_and_fetches_nothing(written: Path) -> None:
    page = Page(written.read_text(encoding="utf-8"))
    assert not page.open
    assert len(page.sources) == len(FIGURES) + 1 + 40
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    assert not re.search(r"https?:|url\(|@import", re.sub(r"base64,[^\"]*", "", written.read_text()))


def test_a_page_shows_the_figures_of_the_summary_and_of_the_ledger(written: Path) -> None:
    summary = small_run().summary
    words = Page(written.read_text(encoding="utf-8")).words
    assert f"Not finished after {summary['steps']} steps: out of steps" in words
    assert summary["digest"] in words
    assert f"{100 * summary['coverage']:.1f} %" in words
    for kind, size in summary["bytes"].items():
        assert f"{size:,}" in words
        assert kind == "total" or f"{100 * size / summary['bytes']['total']:.1f} %" in words
    ledger = archive.read(written.parent).ledger
    for robot in range(3):
        sent = int(ledger["bytes"][ledger["carried"] & (ledger["sender"] == robot)].sum())
        assert f"{sent:,}" in words


def test_a_page_shows_how_well_each_robots_walls_fit(tmp_path: Path) -> None:
    noisy = parse(SETTINGS | {"steps": 15, "laser": {"preset": "utm-30lx"}})
    summary = explore(noisy, out=tmp_path / "run").summary
    words = Page(write_report(tmp_path / "run").read_text(encoding="utf-8")).words
    table = words.split("Walls on the robots' maps")[1].split("Precision:")[0]
    assert "agreement within 1 cell" in table
    for figures in summary["robot_maps"].values():
        walls = [value for name, value in figures.items() if "wall" in name]
        shown = r"\s+".join(f"{100 * value:.1f} %" for value in walls)
        assert re.search(shown, table)
    assert f"mean {100 * summary['claimed_mean_wall_f1']:.1f} %, worst robot" in words


def test_a_slider_has_a_picture_per_step_up_to_a_size_limit(
    written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = [int(step) for step in re.findall(r'data-step="(\d+)"', written.read_text(encoding="utf-8"))]
    assert steps == list(range(1, 41))
    assert written.stat().st_size < 4e6
    run = archive.read(written.parent)
    monkeypatch.setattr(report, "MOST_FRAMES", 40)
    monkeypatch.setattr(report, "MOST_FRAME_BYTES", 200_000)
    fewer = report._frames([Frames(run, 400)])
    assert sum(len(frame.source) for frame in fewer) < 210_000
    assert fewer[-1].step == 40
    assert 2 < len(fewer) < 40


def test_the_last_picture_has_its_cursor_at_the_border_of_the_charts_despite_rounding(
    written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left, right = 121.35, 356.79
    assert left + (right - left) * 39 / 39 > right
    frames = Frames(archive.read(written.parent), 400)
    charts, _ = frames._charts
    monkeypatch.setitem(frames.__dict__, "_charts", (charts, [(left, right, 5.0, 20.0)]))
    assert frames.at(frames.last_step).width == 400


def test_two_runs_are_compared_on_a_page(directory: Path, tmp_path: Path) -> None:
    other = explore(
        parse(SETTINGS | {"map_encoding": "scans", "steps": 30}), out=tmp_path / "scans"
    ).directory
    assert other is not None
    done = CliRunner().invoke(app, ["report", str(directory), str(other)])
    assert done.exit_code == 0, done.output
    page = Page((directory / "compared-with-scans.html").read_text(encoding="utf-8"))
    assert len(page.sources) == 3 + 3
    assert not page.open
    assert re.search(r"run and scans", page.words)
    assert re.search(r"map_encoding\s+polygons\s+scans", page.words)
    assert re.search(r"steps\s+40\s+30", page.words)
    assert "seed" not in page.words.split("Different settings")[1].split("Step by step")[0]
    for folder in (directory, other):
        summary = run_directory.read_summary(folder)
        assert summary["digest"] in page.words
        assert f"{summary['bytes']['total']:,}" in page.words
    turned = Page(write_report(other, directory).read_text(encoding="utf-8"))
    assert re.search(r"approximation error \(Eq. 6.1\)\s+-\s+\d", turned.words), "only the second run has one"


def test_a_run_without_traffic_has_a_page(tmp_path: Path) -> None:
    alone = parse({"bus": "memory", "robots": 1, "steps": 3, "bandwidth": "unlimited"})
    explore(alone, out=tmp_path / "run")
    assert "0 bytes in 0 packets" in write_report(tmp_path / "run").read_text(encoding="utf-8")


def test_panels_without_traffic_begin_at_zero(tmp_path: Path) -> None:
    alone = parse({"bus": "memory", "robots": 1, "steps": 3, "bandwidth": "unlimited"})
    explore(alone, out=tmp_path / "run")
    _, load, wait, delivered = channel_load(archive.read(tmp_path / "run")).axes
    assert [axes.get_ylim() for axes in (load, wait, delivered)] == [(0, 1)] * 3


def test_other_folders_and_damaged_tables_are_refused(tmp_path: Path, directory: Path) -> None:
    with pytest.raises(ScenarioError, match=r"not a run directory"):
        write_report(tmp_path)
    ledger, steps = (directory / name for name in (run_directory.LEDGER, run_directory.STEPS))
    steps.write_bytes(ledger.read_bytes())
    with pytest.raises(
        ScenarioError, match=r"steps.parquet: not the table of a run: columns missing: robot, x, y"
    ):
        write_report(directory)
    steps.write_bytes(ledger.read_bytes()[:-9])
    with pytest.raises(ScenarioError, match=r"steps.parquet: damaged table"):
        write_report(directory)
    steps.unlink()
    with pytest.raises(ScenarioError, match=r"steps.parquet is missing"):
        write_report(directory)
    shutil.copy(small_directory() / run_directory.STEPS, steps)
    (directory / MAP_CHANGES).unlink()
    with pytest.raises(ScenarioError, match=r"map_changes.parquet is missing"):
        write_report(directory)


@pytest.mark.parametrize(
    ("key", "value"), [("robots", 2), ("seed", 7), ("bandwidth", 3), ("strategy", "nearest")]
)
def test_a_scenario_that_was_changed_after_the_run_is_refused(
    directory: Path, key: str, value: object
) -> None:
    """Reports would show figures of the run with settings of another one, and exports would lack robots."""
    scenario = directory / run_directory.SCENARIO
    line = re.compile(rf"^{key} = .*$", re.M)
    changed, count = line.subn(f"{key} = {value!r}", scenario.read_text(), count=1)
    assert count == 1
    scenario.write_text(changed)
    for words in (["report"], ["export", "--mcap"], ["movie"]):
        done = CliRunner().invoke(app, [*words, str(directory)])
        assert done.exit_code == 2, done.output
        assert f"{key} = {value!r} in scenario.toml, but the run had " in done.stderr


@pytest.mark.parametrize("name", [run_directory.STEPS, run_directory.LEDGER, MAP_CHANGES, OUTLINES])
def test_a_flipped_byte_of_a_table_is_found(directory: Path, name: str) -> None:
    """Parquet files have no checksum of their own: most flips give other values, and some crash their reader."""
    whole = (directory / name).read_bytes()
    before = {path.name for path in directory.iterdir()}
    for place in (0.3, 0.5, 0.99):
        damaged = bytearray(whole)
        damaged[int(place * len(whole))] ^= 1
        (directory / name).write_bytes(damaged)
        for words in (["report"], ["export", "--mcap"], ["movie"]):
            done = CliRunner().invoke(app, [*words, str(directory)])
            assert done.exit_code == 2, done.output
            assert f"{directory / name}: damaged table" in done.stderr
    assert {path.name for path in directory.iterdir()} == before


def test_the_command_prints_the_name_of_the_page(directory: Path) -> None:
    done = CliRunner().invoke(app, ["report", str(directory)])
    assert done.exit_code == 0, done.output
    assert done.output.startswith(str(directory / "report.html"))
    assert CliRunner().invoke(app, ["report", str(directory.parent)]).exit_code == 2


def test_many_robots_share_a_median_and_few_have_a_curve_each(tmp_path: Path) -> None:
    crowd = parse({"bus": "memory", "robots": 11, "steps": 6, "map_encoding": "none"})
    explore(crowd, out=tmp_path / "run")
    wait = channel_load(archive.read(tmp_path / "run")).axes[2]
    assert words_of(wait) == [
        "bytes over the step's budget", "log entries of all 11 robots", "middle half", "median",
    ]  # fmt: skip
    wait = channel_load(archive.read(small_directory())).axes[2]
    assert words_of(wait)[1:] == [f"log entries of robot {robot}" for robot in range(3)]


@pytest.mark.parametrize("robots", [3, 11], ids=["curves", "distribution"])
def test_curves_have_a_gap_while_a_robot_is_dead(tmp_path: Path, robots: int) -> None:
    """In the distribution, a dead robot's last value no longer counts."""
    killed = robots - 1
    faults = [{"step": 6, "robot": killed, "kind": "kill"}, {"step": 16, "robot": killed, "kind": "restart"}]
    settings = {"bus": "memory", "robots": robots, "steps": 20, "map": "leader-rooms", "bandwidth": 100}
    explore(parse({**settings, "sensor_range": 2.5, "fault": faults}), out=tmp_path / "run")
    run = archive.read(tmp_path / "run")
    lived = np.isin(np.arange(1, run.last_step + 1), run.of_robot(killed)["step"])
    assert lived.sum() == run.last_step - 10
    (_, *maps), packets = (channel_load(run).axes[at].lines for at in (0, 3))
    if robots == 3:
        assert (np.isfinite(packets[killed].get_ydata()) == lived).all()
        assert np.isnan(maps[killed].get_ydata()[~lived]).all()
        assert maps[killed].get_ydata()[-1] > 0
    else:
        step = 10
        (median,) = packets
        alive = run.steps["backlog"][run.steps["step"] == step]
        assert len(alive) == robots - 1 and median.get_ydata()[step - 1] == np.median(alive)


def test_explored_area_and_load_share_their_time_axis() -> None:
    run = archive.read(small_directory())
    explored, load, *_ = channel_load(run).axes
    (team, *maps) = explored.lines
    seen = run.of_robot(0)["team_seen"]
    assert (team.get_ydata() == 100 * seen).all()
    assert len(maps) == 3
    used = small_run().summary["bytes"]["total"] / (40 * 1000)
    assert load.get_title() == f"Transmitted: {100 * used:.0f} % of the budget"
    assert explored.get_shared_x_axes().joined(explored, load)
    assert explored.get_position().y0 > load.get_position().y0


def words_of(panel: Axes) -> list[str]:
    legend = panel.get_legend()
    assert legend is not None
    return [text.get_text() for text in legend.get_texts()]


class Lost(TargetStrategy):
    """Some robots are lost in a step: their code raises."""

    name, summary, source = "lost", "some robots are lost", "our own"
    robots: ClassVar[tuple[int, ...]] = ()
    step: ClassVar[int] = 0

    def choose(self, situation: Situation, goals: Cells, planner: PathPlanner) -> tuple[int, int]:
        if self.settings.robot in self.robots and situation.step >= self.step:
            raise RuntimeError("lost")
        x, y = goals[0]
        return int(x), int(y)


@pytest.mark.parametrize("step", [1, 4])
@pytest.mark.parametrize("robots", [(0,), (0, 1)])
def test_a_run_that_lost_robots_has_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, robots: tuple[int, ...], step: int
) -> None:
    monkeypatch.setattr(Lost, "robots", robots)
    monkeypatch.setattr(Lost, "step", step)
    settings = {"map": "leader-rooms", "robots": 2, "steps": 8, "bus": "memory"}
    run = explore(strategy=Lost, out=tmp_path / "run", check=False, **settings)
    assert set(run.summary["lost"]) == {str(robot) for robot in robots}
    words = Page(write_report(tmp_path / "run").read_text(encoding="utf-8")).words
    assert "its process ended" in words
