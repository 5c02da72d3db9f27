"""Kernels are compiled at the first call, once per installation, with a note on the error stream."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

MODULE = """
from protocol.kernels import compiled, kernel, loaded


@kernel
def twice(number: int) -> int:
    return number + number


@kernel
def four_times(number: int) -> int:
    return twice(twice(number))


@kernel
def unused(number: int) -> int:
    return number
"""
CALLER = """
from sums import four_times, kernel, twice


@kernel
def eight_times(number: int) -> int:
    return twice(four_times(number))
"""
CALL = "import sums; assert not sums.compiled(); print(sums.four_times(3), sums.loaded(), sums.compiled())"


LOAD_ALL = """
import sums
from protocol.kernels import load_all
load_all()
print(sums.four_times(3), sums.loaded(), sums.compiled())
"""


def call(folder: Path, command: str = CALL, **more: str) -> subprocess.CompletedProcess[str]:
    here = Path(__file__).parents[2]
    more = {"PYTHONPATH": f"{folder}:{here}", "NUMBA_CACHE_DIR": str(folder / "cache")} | more
    return subprocess.run(
        [sys.executable, "-c", command], capture_output=True, text=True, check=True, env=os.environ | more
    )


def test_the_first_call_compiles_all_kernels_and_the_next_reads_the_cache(tmp_path: Path) -> None:
    (tmp_path / "sums.py").write_text(MODULE)
    fresh = call(tmp_path)
    assert fresh.stdout == "12 0 3\n"
    printed = fresh.stderr.splitlines()
    assert printed == ["compiling for this machine, once: 0 of 3 kernels, now sums", "compiled 3 kernels"]
    cached = call(tmp_path)
    assert cached.stdout == "12 1 0\n", "only called kernels are loaded"
    assert cached.stderr == ""


def test_a_kernel_can_be_compiled_after_the_kernels_that_it_calls_were_loaded(tmp_path: Path) -> None:
    (tmp_path / "sums.py").write_text(MODULE)
    assert call(tmp_path, LOAD_ALL).stdout == "12 0 3\n"
    assert call(tmp_path, LOAD_ALL).stdout == "12 3 0\n"
    for file in (tmp_path / "cache").rglob("*four_times*"):
        file.unlink()
    assert call(tmp_path, LOAD_ALL).stdout == "12 2 1\n"


FOLDER = """
import sums
from protocol.kernels import cache_folder, compilation_s
assert cache_folder() == "" and compilation_s() == 0
print(sums.four_times(3), cache_folder(), compilation_s() > 0)
"""


def test_code_that_cannot_be_written_is_cached_in_the_cache_directory_of_the_user(tmp_path: Path) -> None:
    code, home = tmp_path / "code", tmp_path / "home"
    code.mkdir()
    home.mkdir()
    (code / "sums.py").write_text(MODULE)
    (code / "__pycache__").write_text("no directory, so that it cannot be written, not even by root")
    places = {"NUMBA_CACHE_DIR": "", "HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")}
    result, folder, took = call(code, FOLDER, **places).stdout.split()
    assert (result, took) == ("12", "True")
    assert Path(folder).is_relative_to(home)
    assert call(code, FOLDER, **places).stdout.split() == ["12", folder, "False"], "read from the cache"


def test_without_a_directory_for_the_cache_kernels_work_and_the_user_is_advised(tmp_path: Path) -> None:
    code, file = tmp_path / "code", tmp_path / "file"
    code.mkdir()
    file.write_text("no directory")
    (code / "sums.py").write_text(MODULE)
    (code / "__pycache__").write_text("no directory, so that it cannot be written, not even by root")
    nowhere = {"NUMBA_CACHE_DIR": "", "HOME": str(file), "XDG_CACHE_HOME": str(file / "cache")}
    done = call(code, FOLDER, **nowhere)
    assert done.stdout.split() == ["12", "True"]
    first, *others = done.stderr.splitlines()
    assert "set NUMBA_CACHE_DIR to a writable directory" in first, (
        "before the compilation, which takes minutes"
    )
    assert others and "NUMBA_CACHE_DIR" not in " ".join(others)


@pytest.mark.parametrize(
    ("home", "cache"), [("relative", ""), ("relative", "too"), ("", ""), ("", "relative")]
)
def test_kernels_are_never_cached_in_the_working_directory(tmp_path: Path, home: str, cache: str) -> None:
    code, here = tmp_path / "code", tmp_path / "here"
    code.mkdir()
    here.mkdir()
    (code / "sums.py").write_text(MODULE)
    (code / "__pycache__").write_text("no directory, so that it cannot be written, not even by root")
    places = {"NUMBA_CACHE_DIR": "", "HOME": home or str(tmp_path / "home"), "XDG_CACHE_HOME": cache}
    done = call(code, f"import os; os.chdir({str(here)!r})\n{FOLDER}", **places)
    assert ("set NUMBA_CACHE_DIR" in done.stderr) == bool(home), "without a home, the user is advised"
    assert done.stdout.split()[0] == "12" and not list(here.iterdir())


def test_a_kernel_that_calls_kernels_of_the_cache_can_be_compiled(tmp_path: Path) -> None:
    (tmp_path / "sums.py").write_text(MODULE)
    call(tmp_path)
    (tmp_path / "more.py").write_text(CALLER)
    command = (
        "import more, sums; sums.four_times(1); print(more.eight_times(3), sums.loaded(), sums.compiled())"
    )
    assert call(tmp_path, command).stdout == "24 3 1\n"
    assert call(tmp_path, command).stdout == "24 2 0\n"


def test_a_module_that_imports_a_kernel_holds_the_compiled_function_after_its_first_call(
    tmp_path: Path,
) -> None:
    (tmp_path / "sums.py").write_text(MODULE)
    (tmp_path / "caller.py").write_text("from sums import twice\n\ndef call():\n    return twice(3)\n")
    command = (
        "import caller, protocol.kernels; kinds = [isinstance(caller.twice, protocol.kernels.Kernel)];"
        "caller.call(); kinds.append(isinstance(caller.twice, protocol.kernels.Kernel)); print(kinds)"
    )
    assert call(tmp_path, command).stdout == "[True, False]\n"


def test_a_kernel_is_compiled_again_if_one_that_it_calls_has_changed_in_another_module(
    tmp_path: Path,
) -> None:
    (tmp_path / "sums.py").write_text(MODULE)
    (tmp_path / "more.py").write_text(CALLER)
    command = "import more; print(more.eight_times(3))"
    assert call(tmp_path, command).stdout == "24\n"
    (tmp_path / "sums.py").write_text(MODULE.replace("number + number", "number + number + 1"))
    assert call(tmp_path, command).stdout == "31\n"


PARALLEL = """
import sums
from protocol.kernels import compile_in_parallel, compiled, loaded
print(compile_in_parallel(2) > 0, loaded(), compiled(), sums.four_times(3), loaded(), compiled())
"""


def test_processes_compile_kernels_for_later_ones(tmp_path: Path) -> None:
    (tmp_path / "sums.py").write_text(MODULE)
    first = call(tmp_path, PARALLEL)
    assert first.stdout == "True 0 0 12 1 0\n", "this process reads what others have compiled"
    assert first.stderr.splitlines()[0].startswith("compiling for this machine, once: ")
    again = call(tmp_path, PARALLEL)
    assert (again.stdout, again.stderr) == ("False 0 0 12 1 0\n", "")
    assert call(tmp_path, LOAD_ALL).stdout == "12 3 0\n"
