"""Limits of the system: a full disk, little memory and few open files give one line, and lose no result."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from deploy.run.crash_report import traceback_of

MURMUR = [sys.executable, "-m", "deploy.commands.main"]
RUN = ["explore", "--map", "office", "--robots", "3", "--steps", "30"]
MB = 1 << 20


def limited(command: list[str], limit: int, value: int) -> subprocess.CompletedProcess[str]:
    """Run a command with a limit of the system."""
    return subprocess.run(
        command,
        preexec_fn=lambda: resource.setrlimit(limit, (value, value)),
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


@pytest.mark.parametrize("bus", ["memory", pytest.param("zenoh", marks=pytest.mark.long)])
def test_files_that_cannot_be_written_are_named_and_all_others_are_written(tmp_path: Path, bus: str) -> None:
    out = tmp_path / "run"
    done = limited([*MURMUR, *RUN, "--bus", bus, "--out", str(out)], resource.RLIMIT_FSIZE, 10_000)
    (line,) = done.stderr.splitlines()
    assert done.returncode == 3
    assert line.startswith(f"murmur: {out / 'radio.pcapng'}, ")
    assert line.endswith(f"{out / 'maps.png'}: File too large")
    assert json.loads((out / "summary.json").read_text())["steps"] == 30
    assert {"steps.parquet", "ledger.parquet", "team.yaml"} <= {file.name for file in out.iterdir()}
    whole = subprocess.run([*MURMUR, "capture", str(out)], capture_output=True, text=True, check=False)
    assert whole.returncode == 0, whole.stderr


@pytest.mark.parametrize(
    ("limit", "value", "robots", "message"),
    [
        (resource.RLIMIT_AS, 600 * MB, "3", "address space (ulimit -v): the limit is 629 MB; it must be"),
        (
            resource.RLIMIT_DATA,
            300 * MB,
            "3",
            "data of a process (ulimit -d): the limit is 315 MB; it must be",
        ),
        (resource.RLIMIT_NOFILE, 64, "24", "open files (ulimit -n): the limit is 64; a run of 24 robots"),
    ],
)
def test_limit_that_is_too_low_is_named_before_the_run(
    tmp_path: Path, limit: int, value: int, robots: str, message: str
) -> None:
    out = tmp_path / "run"
    done = limited([*MURMUR, *RUN, "--robots", robots, "--out", str(out)], limit, value)
    (line,) = done.stderr.splitlines()
    assert done.returncode == 2
    assert line.startswith(f"murmur: {message}")
    assert line.endswith("or more")
    assert not out.exists()


@pytest.mark.parametrize("bus", ["zenoh", "memory"])
def test_run_that_cannot_fit_into_memory_is_refused_before_it_starts(tmp_path: Path, bus: str) -> None:
    out = tmp_path / "run"
    size = ["--set", "map_options.width_m=200", "--set", "map_options.height_m=200", "--robots", "256"]
    command = [*MURMUR, "explore", *size, "--bus", bus, "--out", str(out)]
    done = limited(command, resource.RLIMIT_AS, 3 << 30)
    (line,) = done.stderr.splitlines()
    assert done.returncode == 2
    assert line.startswith(f"murmur: robots = 256 on 2000 x 2000 cells: bus = '{bus}' needs about ")
    assert not out.exists()


def test_low_soft_limit_on_open_files_is_raised(tmp_path: Path) -> None:
    program = (
        "import resource; from deploy.run.limits import check_files; "
        "resource.setrlimit(resource.RLIMIT_NOFILE, (64, 1024)); check_files(100); "
        "print(resource.getrlimit(resource.RLIMIT_NOFILE))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "(240, 1024)\n"


def test_libraries_that_write_the_results_are_imported_before_the_run(tmp_path: Path) -> None:
    program = f"""
import sys
from murmur import explore
seen = []
def watch(plan, records):
    seen.append({{"pyarrow.parquet", "matplotlib.figure"}} <= set(sys.modules))
explore(map="office", robots=1, steps=2, bus="memory", out={str(tmp_path / "run")!r}, watch=watch)
assert seen and seen[0]
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


def test_process_without_memory_reports_one_line() -> None:
    try:
        raise MemoryError
    except MemoryError as error:
        assert traceback_of(error) == "out of memory"
