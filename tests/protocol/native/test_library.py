"""The library of kernels: same results and errors as numba's, no numba in the process, nothing out of date."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from protocol.native.build import COMPILERS
from tests.protocol.native import checks

HAS_COMPILER = any(map(shutil.which, COMPILERS))
ROOT = Path(__file__).parents[3]
BUILD = """
import parts
from protocol.native.build import BuildError, build_library
try:
    print(build_library(2))
except BuildError as error:
    print("failed:", error)
"""

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not HAS_COMPILER, reason="no C compiler")]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a directory with a module of kernels and their library."""
    folder = tmp_path_factory.mktemp("built")
    (folder / "parts.py").write_text(checks.PARTS)
    assert run(folder, BUILD) == f"{checks.PARTS.count('@kernel')}\n"
    return folder


@pytest.fixture
def copy(built: Path, tmp_path: Path) -> Path:
    """Return a copy of the directory, which a test may change."""
    return Path(shutil.copytree(built, tmp_path / "copy"))


def run(folder: Path, code: str, *arguments: str, **more: str) -> str:
    """Run Python code beside the module of kernels; return what it prints."""
    return start(folder, code, arguments, more).communicate()[0]


def start(
    folder: Path, code: str, arguments: Sequence[str] = (), more: dict[str, str] | None = None
) -> subprocess.Popen[str]:
    """Start Python code beside the module of kernels."""
    places = {"PYTHONPATH": f"{folder}:{ROOT}", "NUMBA_CACHE_DIR": str(folder / "cache")} | (more or {})
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | places)


def library_file(folder: Path) -> Path:
    (file,) = (folder / "cache").glob("murmur_*/*.so")
    return file


def call(folder: Path, name: str, by: str = "library") -> str:
    """Call a function of `checks` in a process whose kernels come from the library, or from numba."""
    code = f"import sys\nfrom tests.protocol.native import checks\nchecks.{name}()\nprint('numba' in sys.modules)"
    more = {"NUMBA_CACHE_DIR": str(folder / "numba")} if by == "numba" else {}
    printed, _, imported = run(folder, code, **more).rstrip().rpartition("\n")
    assert imported == str(by == "numba")
    assert printed
    return printed


@pytest.mark.parametrize("name", ["print_results", "print_conversions", "print_errors", "print_exceptions"])
def test_the_library_gives_what_numba_gives_without_importing_it(built: Path, name: str) -> None:
    assert call(built, name) == call(built, name, by="numba")


def test_arguments_that_do_not_fit_are_named_with_what_would_be_right(built: Path) -> None:
    code = "import numpy as np, parts\ntry: parts.total(np.zeros((2, 2), np.int32)[:, 0], 1.0)\n"
    code += "except TypeError as error: print(error)"
    assert run(built, code) == (
        "total(): argument numbers must be a contiguous, writable, 1-dimensional array of int64, "
        "not a 1-dimensional array of int32, not contiguous\n"
    )


def test_returned_arrays_keep_memory_as_long_as_they_live(built: Path) -> None:
    assert call(built, "print_references") == "all memory is released"


def test_a_changed_constant_or_body_is_compiled_again_with_its_callers_only(copy: Path) -> None:
    code = "import parts; print(parts.shifted(1), parts.twice_shifted(1), parts.less(1, 2)); "
    code += (
        "from protocol import kernels; print([k.__name__ for k in kernels.all_kernels() if k.was_compiled])"
    )
    assert run(copy, code) == "11 22 True\n[]\n"
    file = copy / "parts.py"
    file.write_text("# a comment\n" + file.read_text().replace("SHIFT = 10", "SHIFT = 20"))
    assert run(copy, code) == "21 42 True\n['shifted', 'twice_shifted']\n"
    file.write_text(
        "# another comment\n" + file.read_text().replace("return one < other", "return one > other")
    )
    assert run(copy, code) == "21 42 False\n['shifted', 'twice_shifted', 'less']\n"


def test_a_kernel_that_is_not_in_the_library_can_call_one_that_is(copy: Path) -> None:
    (copy / "plug_in.py").write_text(checks.PLUG_IN)
    code = "import parts, plug_in; from protocol.kernels import all_kernels; "
    code += "print(parts.shifted(1), plug_in.thrice_shifted(1), parts.twice_shifted(1)); "
    code += "print(all(each.digest for each in all_kernels()))"
    assert run(copy, code) == "11 33 22\nTrue\n"


def test_a_library_that_is_damaged_or_of_another_environment_is_not_used(tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text(checks.SMALL)
    builds = [start(tmp_path, BUILD) for _ in range(2)]
    assert [build.communicate()[0] for build in builds] == ["1\n"] * 2, "at the same time"
    file = library_file(tmp_path)
    assert list(file.parent.iterdir()) == [file], "no temporary files remain"
    assert run(tmp_path, BUILD) == "0\n", "it is valid"
    code = "import parts; from protocol.native.library import library_file; print(parts.shifted(1), library_file())"
    assert run(tmp_path, code) == f"11 {file}\n"
    assert run(tmp_path, code, NUMBA_OPT="2") == "11 None\n"
    file.write_bytes(b"damaged")
    assert run(tmp_path, code) == "11 None\n"


def test_without_a_working_compiler_the_reason_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text(checks.SMALL)
    missing = run(tmp_path, BUILD, CC=str(tmp_path / "none"))
    assert missing.startswith("failed: the C compiler cannot be called: ")
    assert run(tmp_path, BUILD, CC="false") == "failed: the C compiler failed: exit code 1\n"
    assert (
        run(tmp_path, BUILD, CC="", PATH="") == f"failed: no C compiler was found ({', '.join(COMPILERS)})\n"
    )


def test_every_kernel_of_murmur_can_be_in_the_library() -> None:
    from deploy.run import processes  # noqa: F401
    from protocol.kernels import all_kernels
    from worldsim import people, world  # noqa: F401

    assert [each.__qualname__ for each in all_kernels() if not each.digest] == []
