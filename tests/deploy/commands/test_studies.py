"""`murmur sweep`: its output, its files and its exit codes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import psutil
import pytest
from PIL import Image
from typer.testing import CliRunner

from deploy.commands import study_output
from deploy.commands.app import app
from tests.deploy.study.small_experiment import EXPERIMENT, write
from tests.worldsim.recorded.made_logs import write_carmen

MURMUR = [sys.executable, "-m", "deploy.commands.main"]


def command(*words: object, of: str = "sweep") -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [of, *map(str, words)])
    return result.exit_code, result.stdout, result.stderr


def test_the_command_prints_the_table_and_writes_runs_means_and_pictures(tmp_path: Path) -> None:
    plot = '[[plot]]\nkind = "curves"\ny = "explored"\n[[plot]]\nx = "robots"\ny = "steps"\n'
    path, out = write(tmp_path, EXPERIMENT + plot), tmp_path / "all.parquet"
    means, picture = tmp_path / "means.csv", tmp_path / "some.png"
    code, table, _ = command(
        path,
        "--jobs",
        1,
        "--set",
        "robots=1",
        "--set",
        "seed=0",
        "--out",
        out,
        "--table",
        means,
        "--plot",
        picture,
        "--formats",
        "pdf,svg,csv,tex",
        "--font",
        "serif",
        "--font-size",
        8,
        "--figure-width",
        8.8,
    )
    assert code == 0 and "2 runs; means of n each:" in table
    assert pl.read_parquet(out)["steps"].to_list() == [6, 6]
    assert pl.read_csv(means)["variant"].to_list() == ["polygons", "polygons", "scans", "scans"]
    assert pl.read_csv(tmp_path / "means-table.csv").columns == [
        "robots",
        "variant",
        "n",
        "steps",
        "bytes.total",
    ]
    first = (tmp_path / "means-table.tex").read_text().splitlines()[:3]
    assert first == [r"\begin{tabular}{rlrrr}", r"\toprule", r"robots & variant & n & steps & bytes.total \\"]
    pictures = {file.name for file in tmp_path.iterdir() if file.stem in ("some", "some-2")}
    assert pictures == {f"some{number}.{ending}" for number in ("", "-2") for ending in ("png", "pdf", "svg")}
    assert Image.open(picture).width == pytest.approx(8.8 / 2.54 * 90, abs=1)


def test_sweep_writes_the_files_that_links_in_a_read_only_directory_lead_to(tmp_path: Path) -> None:
    links = tmp_path / "links"
    links.mkdir()
    runs, means = links / "runs.parquet", links / "means.csv"
    for link in (runs, means):
        link.symlink_to(Path("..") / link.name)
    links.chmod(0o555)
    try:
        chosen = "--set", "robots=[2]", "--seeds", 1, "--jobs", 1
        code, _, errors = command(write(tmp_path, EXPERIMENT), "--out", runs, "--table", means, *chosen)
    finally:
        links.chmod(0o755)
    assert code == 0 and len(pl.read_parquet(tmp_path / "runs.parquet")) > 0, errors
    assert not (tmp_path / "means.csv").is_symlink() and len(pl.read_csv(tmp_path / "means.csv")) > 0
    assert {each for each in links.iterdir() if each.is_symlink()} == set(links.iterdir()) == {runs, means}


@pytest.mark.parametrize(
    ("target", "reason"),
    [
        ("/proc/sys/a.parquet", "nothing can be written in /proc/sys; name another"),
        ("/nonexist/a.parquet", "no such folder: /nonexist"),
        ("link.parquet", "Too many levels of symbolic links; name another"),
    ],
)
def test_sweep_checks_the_file_that_a_link_leads_to(tmp_path: Path, target: str, reason: str) -> None:
    link = tmp_path / "link.parquet"
    link.symlink_to(target)
    code, table, errors = command(write(tmp_path, EXPERIMENT), "--out", link)
    assert (code, table) == (2, "") and f"out = {link}: {reason}" in errors


@pytest.mark.parametrize(
    ("words", "output"),
    [
        (["--out", "/nonexist/a.parquet"], "/nonexist/a.parquet: no such folder: /nonexist"),
        (
            ["--table", "/proc/sys/a.csv"],
            "table = /proc/sys/a.csv: nothing can be written in /proc/sys; name",
        ),
        (["--set", "map=nope"], "unknown map 'nope'"),
        (
            ["--set", "seed=0", "--set", "seed=1"],
            "set = 'seed=1': seed is given twice",
        ),
        (["--set", "seed"], "set = 'seed': must be NAME=VALUE, as seed=[0,1]"),
        (
            ["--set", "map=[{ map = 'office' ]"],
            "set = 'map=...': \"[{ map = 'office' ]\" is no list or table",
        ),
        (["--set", "robots=[2]\nspeed=3"], "has more than one value"),
        (["--set", "map=" + "{a=" * 5000], "set = 'map=...': nested too deeply"),
        (["--set", "robots= [2, 3"], "set = 'robots=...': ' [2, 3' is no list or table"),
        (["--formats", "pdf"], "formats: needs --plot FILE or --table FILE"),
        (["--formats", "jpg"], "formats = 'jpg': must be some of pdf, svg, csv, tex"),
        (["--font", "Nope"], "font = 'Nope': is not installed; use serif, sans-serif, monospace"),
        (["--figure-width", "300"], "figure_width = 300: must be from 4 to 100"),
        (["--plot", "a.png"], "plot = a.png: "),
        (["--out", "a.parquet", "--table", "./a.parquet"], "table = a.parquet: is also the file of --out"),
        (["--seeds", "2", "--set", "seed=[7]"], "--seeds and --set seed: give only one of them"),
        (["--plot", "a.gif"], "plot = a.gif: must end in .png or .pdf or .svg"),
    ],
)
def test_bad_input_is_refused_before_the_first_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], output: str
) -> None:
    monkeypatch.setattr("deploy.run.workers.ProcessPoolExecutor.submit", None)
    code, table, errors = command(write(tmp_path, EXPERIMENT), *words)
    assert (code, table, errors.count("\n")) == (2, "", 1)
    assert output in errors


def test_test_seeds_replace_the_seeds_of_a_sweep(tmp_path: Path) -> None:
    out = tmp_path / "all.parquet"
    path = write(tmp_path, EXPERIMENT)
    assert command(path, "--jobs", 1, "--set", "robots=1", "--test-seeds", 2, "--out", out)[0] == 0
    assert sorted(pl.read_parquet(out)["seed"]) == [1000, 1000, 1001, 1001]


def test_values_of_settings_may_be_tables_in_toml(tmp_path: Path) -> None:
    out, path = tmp_path / "all.parquet", write(tmp_path, EXPERIMENT)
    maps = "map=[{ map = 'em', map_options = { resolution = 0.4 } }]"
    code, _, errors = command(
        path, "--jobs", 1, "--set", "robots=1", "--set", "seed=0", "--set", maps, "--out", out
    )
    assert code == 0, errors
    assert set(pl.read_parquet(out)["map"]) == {"em"}


def test_the_command_tune_writes_trials_and_weights_and_continues(tmp_path: Path) -> None:
    out = tmp_path / "tuned"
    words = ["meier", "--maps", "em", "--seeds", "0", "--check-seeds", "1", "--evaluations", 3, "--jobs", 1]
    words += [
        "--set",
        "robots=2",
        "--set",
        'map_options={"resolution": 0.4}',
        "--set",
        "steps=30",
        "--out",
        out,
    ]
    code, table, errors = command(*words, of="tune")
    assert code == 0 and "score em" in table and "tune: begins" in errors
    trials = pl.read_csv(out / "trials.csv")
    assert trials["trial"].to_list() == [0, 1, 2] and trials["beta"].to_list() == [1.0, 2.0, 0.5]
    assert tomllib.loads((out / "weights.toml").read_text())["strategy"] == "meier"
    runs = (out / "runs.parquet").read_bytes()
    assert command(*words, of="tune")[1] == table
    assert (out / "runs.parquet").read_bytes() == runs


def sweeping_in_a_group(path: Path, out: Path, *words: str) -> subprocess.Popen[str]:
    """A sweep by two processes, in a process group of its own."""
    return subprocess.Popen(
        [*MURMUR, "sweep", path, "--jobs", "2", *words, "--out", out],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )  # fmt: skip


def begun(tmp_path: Path, out: Path) -> subprocess.Popen[str]:
    """A sweep of eight runs in a process group of its own, of which one at least is finished."""
    text = EXPERIMENT.replace("seed = [0, 1]", "seed = [0, 1]\nsteps = [1, 5000]").replace("steps = 6\n", "")
    path = write(tmp_path, text.replace('"em"', '"office"'))
    sweeping = sweeping_in_a_group(path, out, "--set", "robots=12")
    while not out.exists() or not len(pl.read_parquet(out)):
        assert sweeping.poll() is None
        time.sleep(0.1)
    return sweeping


def assert_none_is_left(group: int) -> None:
    deadline = time.monotonic() + 10
    with pytest.raises(ProcessLookupError):
        while time.monotonic() < deadline:
            os.killpg(group, 0)
            time.sleep(0.1)


@pytest.mark.parametrize(
    ("number", "send"),
    [(signal.SIGINT, os.killpg), (signal.SIGTERM, os.kill), (signal.SIGHUP, os.killpg)],
    ids=["ctrl-c", "sigterm", "sighup"],
)
def test_a_signal_stops_a_sweep_at_once_and_keeps_what_is_finished(
    tmp_path: Path, number: int, send: Callable[[int, int], None]
) -> None:
    out = tmp_path / "all.parquet"
    sweeping = begun(tmp_path, out)
    send(sweeping.pid, number)
    asked = time.monotonic()
    table, errors = sweeping.communicate(timeout=60)
    assert sweeping.returncode == 130 and time.monotonic() - asked < 30
    assert_none_is_left(sweeping.pid)
    assert f"stopped; the same command continues from {out}" in errors and "Traceback" not in errors
    kept = len(pl.read_parquet(out))
    assert 0 < kept < 8 and f"{kept} of 8 runs; means of n each" in table


def test_ctrl_c_while_the_fork_server_starts_stops_a_sweep(tmp_path: Path) -> None:
    out = tmp_path / "all.parquet"
    sweeping = sweeping_in_a_group(write(tmp_path, EXPERIMENT), out)
    family = psutil.Process(sweeping.pid)
    while not any("multiprocessing.forkserver" in " ".join(each.cmdline()) for each in family.children()):
        assert sweeping.poll() is None
        time.sleep(0.02)
    os.killpg(sweeping.pid, signal.SIGINT)
    _, errors = sweeping.communicate(timeout=60)
    assert sweeping.returncode == 130
    assert_none_is_left(sweeping.pid)
    assert f"stopped; the same command continues from {out}" in errors and "Traceback" not in errors


def test_ctrl_c_while_pictures_are_drawn_says_how_to_continue_and_leaves_no_part_of_a_file(
    tmp_path: Path,
) -> None:
    out, means = tmp_path / "all.parquet", tmp_path / "means.csv"
    plots = '[[plot]]\nx = "robots"\ny = "steps"\n' * 40
    words = "--table", means, "--plot", tmp_path / "a.png", "--formats", "pdf,svg", "--seeds", "1"
    sweeping = sweeping_in_a_group(write(tmp_path, EXPERIMENT + plots), out, *map(str, words))
    while not means.exists():
        assert sweeping.poll() is None
        time.sleep(0.02)
    os.killpg(sweeping.pid, signal.SIGINT)
    _, errors = sweeping.communicate(timeout=60)
    assert (sweeping.returncode, len(pl.read_parquet(out))) == (130, 4)
    assert f"stopped; the same command continues from {out}" in errors and "Traceback" not in errors
    assert [each.name for each in tmp_path.glob(".*")] == [".all.parquet.lock"]


TIMES = ("wall_s", "steps_per_s", "work_us_median")


def test_a_sweep_that_is_killed_goes_on_to_the_same_table_and_nothing_outlives_it(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        EXPERIMENT.replace("steps = 6", "steps = 12").replace("seed = [0, 1]", f"seed = {[*range(12)]}"),
    )
    whole, out = tmp_path / "whole.parquet", tmp_path / "killed.parquet"
    assert command(path, "--jobs", 1, "--out", whole)[0] == 0
    sweeping = sweeping_in_a_group(path, out)
    while not out.exists() or not len(pl.read_parquet(out)):
        assert sweeping.poll() is None
        time.sleep(0.05)
    sweeping.kill()
    sweeping.communicate(timeout=30)
    assert_none_is_left(sweeping.pid)
    kept = len(pl.read_parquet(out))
    assert 0 < kept < 48
    assert command(path, "--jobs", 1, "--out", out)[0] == 0
    assert pl.read_parquet(out).drop(TIMES).equals(pl.read_parquet(whole).drop(TIMES))


def fail_runs(table: Path, **settings: object) -> None:
    chosen = pl.all_horizontal(pl.col(name) == value for name, value in settings.items())
    spoilt = pl.when(chosen).then(pl.lit("it broke")).otherwise(pl.col("error")).alias("error")
    pl.read_parquet(table).with_columns(spoilt).write_parquet(table)


def test_a_command_whose_runs_failed_ends_with_3_after_all_results(tmp_path: Path) -> None:
    out = tmp_path / "c"
    words = ["--map-encodings", "none,predictive", "--map", "em", "--seeds", 2, "--jobs", 1, "--out", out]
    words += ["--set", "steps=2", "--set", "robots=1"]
    assert command(*words, of="compare")[0] == 0
    fail_runs(out / "runs.parquet", map_encoding="none", seed=0)
    code, table, errors = command(*words, of="compare")
    assert code == 3
    assert "1 run failed: it broke" in errors and "none and predictive" in table
    fail_runs(out / "runs.parquet", map_encoding="none")
    code, table, errors = command(*words, of="compare")
    assert (code, table) == (3, "")
    assert errors.endswith("murmur: none: all runs failed: it broke (2 runs)\n")


def test_a_sweep_and_a_sizing_with_failed_runs_end_with_3(tmp_path: Path) -> None:
    path, out = write(tmp_path, EXPERIMENT), tmp_path / "all.parquet"
    words = [path, "--jobs", 1, "--set", "robots=1", "--out", out]
    assert command(*words)[0] == 0
    fail_runs(out, seed=0)
    code, table, errors = command(*words)
    assert code == 3
    assert "2 runs failed: it broke" in errors and "2 of 4 runs; means of n each" in table
    words = ["--map", "em", "--robots", "1", "--bandwidth", "9", "--range", "50%", "--seeds", 2, "--jobs", 1]
    words += ["--set", "steps=2", "--out", tmp_path / "size"]
    assert command(*words, of="size")[0] == 1
    fail_runs(tmp_path / "size" / "runs.parquet", seed=0)
    assert command(*words, of="size")[0] == 3


def test_teams_are_compared_by_the_command(tmp_path: Path) -> None:
    words = ["--strategies", "leaders,potential-field", "--map", "leader-rooms", "--seeds", 3, "--jobs", 1]
    for setting in ("sensor_range=2.5", "speed=1.0", "map_encoding=scans", "bandwidth=unlimited"):
        words += ["--set", setting]
    code, text, _ = command(*words, "--out", tmp_path / "c", "--formats", "svg,tex", of="compare")
    assert code == 0 and "leaders" in text and " times the steps of " in text
    written = {file.name for file in (tmp_path / "c").iterdir()}
    assert written >= {"boxes.png", "curves.png", "means.csv", "runs.parquet"}
    assert written >= {"boxes.svg", "curves.svg", "means-table.tex"}


def test_a_table_that_is_wider_than_the_terminal_is_turned_and_names_plug_ins_as_they_name_themselves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "lazy.py").write_text(
        "from agent.strategies.burgard import Nearest\n\n\n"
        'class Lazy(Nearest):\n    name, summary, source = "lazy-walk", "as nearest", "our own"\n'
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(study_output, "FILE_WIDTH", 80)
    words = ["--strategies", "lazy:Lazy,nearest", "--map", "em", "--robots", 1, "--seeds", 2, "--jobs", 1]
    code, text, _ = command(*words, "--set", "steps=2", "--out", "c", of="compare")
    assert code == 0
    head, rule, *lines = text.splitlines()[2:]
    assert head.split() == ["variant", "lazy-walk", "nearest"] and set(rule.strip()) == {
        "\N{BOX DRAWINGS LIGHT HORIZONTAL}"
    }
    assert [line.split()[0] for line in lines[:4]] == ["n", "steps", "t90", "map_accuracy"]
    assert "lazy-walk and nearest: no pair of runs to compare (2 excluded as unfinished or 0)." in lines
    monkeypatch.setattr(study_output, "FILE_WIDTH", 40)
    _, text, _ = command(*words, "--set", "steps=2", "--out", "c", of="compare")
    assert {"mean_", "map_", "accuracy"} <= {
        line.split()[0] for line in text.splitlines()[2:] if line.strip()
    }


@pytest.mark.parametrize("width", [40, 60, 80, 160])
def test_a_table_with_many_columns_is_printed_in_parts_without_breaking_numbers(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(study_output, "FILE_WIDTH", width)
    rows = [[f"kind-{number}", "1.000 \u00b1 0.125", "12345 \u00b1 6789"] for number in range(7)]
    study_output.print_table([["variant", "claimed_worst_wall_f1", "bytes.total"], *rows])
    text = capsys.readouterr().out
    assert all(len(line) <= width for line in text.splitlines())
    assert text.count("1.000 \u00b1 0.125") == text.count("12345 \u00b1 6789") == 7
    assert all(f"kind-{number} " in text for number in range(7))


def test_radios_are_compared_with_the_settings_of_a_scenario_as_for_a_log(tmp_path: Path) -> None:
    write_carmen(tmp_path / "room.log", scans=12)
    scenario = tmp_path / "room.toml"
    scenario.write_text('robots = 2\nbandwidth = 3\n[recording]\nfiles = ["room.log"]\npace = "recorded"\n')
    words = [scenario, "--radios", "lora-sf12,zigbee", "--metric", "steps_after_scans", "--seeds", "2"]
    code, text, errors = command(*words, "--out", tmp_path / "c", of="compare")
    assert code == 0, errors
    assert [
        name for name in ("lora-sf12", "zigbee", "steps_after_scans", "bytes_per_scan") if name not in text
    ] == []
    runs = pl.read_parquet(tmp_path / "c" / "runs.parquet")
    assert set(runs["range_m"]) == {132276.0, 107.0}
    assert set(runs["bandwidth"]) == {"18", "15782"}, "the radio's, not the scenario's"


def test_compare_has_flags_for_sensors_and_for_the_resolution_of_a_picture(tmp_path: Path) -> None:
    room = np.zeros((60, 60), np.uint8)
    room[3:-3, 3:-3] = 255
    Image.fromarray(room).save(tmp_path / "room.png")
    words = [
        "--map",
        tmp_path / "room.png",
        "--resolution",
        0.1,
        "--laser",
        "sick-lms",
        "--pose",
        "graph-slam",
    ]
    words += ["--strategies", "nearest,greedy", "--robots", 1, "--seeds", 2, "--jobs", 1, "--set", "steps=2"]
    code, _, errors = command(*words, "--out", tmp_path / "c", of="compare")
    assert code == 0, errors


def test_size_prints_a_line_per_radio_and_progress_from_the_beginning(tmp_path: Path) -> None:
    words = [
        "--radio",
        "wifi,lora-sf9",
        "--map",
        "leader-rooms",
        "--robots",
        "1",
        "--seeds",
        "1",
        "--jobs",
        "1",
    ]
    words += ["--sensor-range", "2.5", "--speed", "1.0", "--out", str(tmp_path / "size")]
    code, text, errors = command(*words, of="size")
    assert code == 0, errors
    assert errors.splitlines()[0] == "size: 0 of 2"
    assert "legal limit" in text and "ETSI EN 300 220-2, 868.0 to 868.6 MHz" in text
    assert "Duty cycles keep the legal limit (lora-sf9)" in text
    assert (tmp_path / "size" / "radios.csv").exists()
    assert command(*words, "--deadline", "2", of="size")[0] == 1


@pytest.mark.parametrize("words", [("--radio", "morse"), ("--radio", "wifi", "--map", "nowhere")])
def test_an_error_of_size_is_all_that_it_prints(tmp_path: Path, words: tuple[str, ...]) -> None:
    code, text, errors = command(*words, "--out", str(tmp_path / "size"), of="size")
    assert (code, text, list(tmp_path.iterdir())) == (2, "", [])
    assert words[-1] in errors and len(errors.splitlines()) == 1


@pytest.mark.parametrize(
    ("words", "output"),
    [
        (["compare"], "give either scenario files, --strategies, --map-encodings or --radios"),
        (["compare", "a.toml", "b.toml", "--radios", "wifi"], "or one scenario file and one of these flags"),
        (["compare", "a.toml", "--radios", "wifi,ble"], "scenario a.toml: no such file"),
        (
            ["size", "--radio", "wifi", "--set", 'recording.files=["a.log"]'],
            "recording: murmur size lets teams explore a building; for a log, compare radios instead",
        ),
        (["compare", "--strategies", "meier,meyer"], "did you mean meier"),
        (["compare", "--strategies", "meier"], "nothing to compare"),
        (
            ["size", "--robots", "two"],
            "robots = 'two': must be whole numbers of at most 256, as 2..8 or 2,4,8",
        ),
        (["size", "--bandwidth", "much"], "must be a whole number of bytes per step"),
        (["size", "--radio", "zigbee,zigby"], "no radio preset is called 'zigby'; did you mean zigbee"),
        (
            ["size", "--radio", "zigbee", "--range", "5"],
            "sets bandwidth and range; omit --bandwidth and --range",
        ),
        (
            ["size", "--set", 'radio.preset=["zigbee"]'],
            "must be one name; lists are axes of sweep, compare, and size",
        ),
        (["compare", "--radios", "zigbee,zigby"], "no radio preset is called 'zigby'; did you mean zigbee"),
        (["sweep", "lossy.toml", "--set", 'radio.preset=["zigbee","zigby"]'], "'zigby'; did you mean zigbee"),
        (["size", "--radio", ""], "radio = '': is empty; give values separated by commas, or omit --radio"),
        (["size", "--bandwidth", ","], "bandwidth = ',': is empty"),
        (["size", "--range", ""], "range = '': is empty"),
        (["compare", "--map-encodings", ""], "map-encodings = '': is empty"),
        (["sweep", "lossy.toml", "--variant", "all"], "no variant is called 'all'; there are: 'default', "),
        (["reproduce", "X9"], "no claim is called 'X9'"),
        (["sweep", "lossy.toml", "--scheduler", "nowhere"], "scheduler = 'nowhere'"),
    ],
)
def test_bad_input_of_the_others_is_refused(tmp_path: Path, words: list[str], output: str) -> None:
    out = [] if words[0] == "sweep" else ["--out", tmp_path / "out"]
    code, _, errors = command(*words[1:], *out, of=words[0])
    assert code == 2 and output in errors and "Traceback" not in errors
