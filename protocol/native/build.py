"""Build the library of kernels: object files by several processes, then one call of the C compiler.

The finished library replaces the former one at once, so other processes may load or build it at the same time.
"""

from __future__ import annotations

import multiprocessing
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from protocol import kernels
from protocol.kernels import Kernel
from protocol.native import library, wrappers
from protocol.native.machine_code import CompiledKernel, compile_to_object

COMPILERS = ("cc", "gcc", "clang")
OPTIONS = ("-O1", "-shared", "-fPIC", "-w", "-fno-strict-aliasing", "-fvisibility=hidden")


class BuildError(RuntimeError):
    """The library cannot be built; the message says why, in one line."""


def build_library(jobs: int) -> int:
    """Build the library of all imported kernels by `jobs` processes, unless it exists; return how many were compiled.

    The error stream shows the progress. Raises BuildError if there is no working C compiler or no directory that can be
    written, or a kernel cannot be in a library.
    """
    ours = [each for each in kernels.all_kernels() if each.digest]
    if all(library.find(each.digest) for each in ours):
        return 0
    with _temporary_folder() as name:
        folder = Path(name)
        _link([], folder)  # an error now, rather than in a minute
        compiled = _compile(ours, jobs)
        file = _link(compiled, folder)
        file.replace(folder.parent / library.file_name())
    library.forget()
    return len(ours)


def _temporary_folder() -> tempfile.TemporaryDirectory[str]:
    """Create a directory in the best place of the library that can be written."""
    if not library.file_name():
        raise BuildError("the versions of numba, llvmlite, and numpy are not known")
    for place in library.folders():
        try:
            place.mkdir(parents=True, exist_ok=True)
            return tempfile.TemporaryDirectory(dir=place, prefix=f"{library.MODULE}-")
        except OSError:
            continue
    raise BuildError(kernels.NO_CACHE)


def _compile(ours: Sequence[Kernel], jobs: int) -> list[CompiledKernel]:
    """Compile kernels to object files. Kernels that call each other are compiled by the same process."""
    done: dict[str, CompiledKernel] = {}
    kernels.report_progress(0, len(ours), 1)
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("fork")) as pool:
        tasks = [pool.submit(_compile_group, [each.number for each in group]) for group in groups(ours)]
        try:
            for task in as_completed(tasks):
                for each in task.result():
                    done[each.function.digest] = each
                    kernels.report_progress(len(done), len(ours), len(done) + 1)
        except Exception as error:
            pool.shutdown(cancel_futures=True)
            raise BuildError(_last_line(str(error)) or type(error).__name__) from error
        finally:
            kernels.report_compiled(len(done))
    return [done[digest] for digest in dict.fromkeys(each.digest for each in ours)]


def _compile_group(numbers: Sequence[int]) -> list[CompiledKernel]:
    """Compile kernels, given by their places among all kernels, in a process for this."""
    return [compile_to_object(kernels.all_kernels()[number]) for number in numbers]


def groups(ours: Sequence[Kernel]) -> list[list[Kernel]]:
    """Return groups of kernels that call no kernel of another group, those with most code first."""
    group_of = {each: [each] for each in ours}
    for each in ours:
        for called in each.called.values():
            group, other = group_of[each], group_of[called]
            if group is not other:
                group += other
                group_of.update(dict.fromkeys(other, group))
    separate = {id(group): group for group in group_of.values()}.values()
    return sorted(separate, key=lambda group: -sum(len(each.function.__code__.co_code) for each in group))


def _link(compiled: Sequence[CompiledKernel], folder: Path) -> Path:
    """Write object files and wrappers into a directory, link them, and try to load the library; return its file."""
    here = Path(__file__).parent
    numba = find_spec("numba")
    assert numba is not None and numba.submodule_search_locations
    include = [here, *numba.submodule_search_locations, np.get_include(), sysconfig.get_path("include")]
    functions = [each.function for each in compiled]
    (folder / "wrappers.c").write_text(wrappers.source(functions, library.MODULE), encoding="utf-8")
    for each in compiled:
        (folder / f"{each.function.symbol}.o").write_bytes(each.code)
    file = folder / f"{len(compiled)}-{library.file_name()}"
    platform = ["-undefined", "dynamic_lookup"] if sys.platform == "darwin" else []
    objects = [f"{each.symbol}.o" for each in functions]
    command = [*_compiler(), *OPTIONS, *platform, *(f"-I{each}" for each in include), "wrappers.c", *objects]
    _run([*command, "-lm", "-o", str(file)], folder)
    try:
        library.load(file)
    except ImportError as error:
        raise BuildError(f"the library cannot be loaded: {error}") from error
    return file


def _run(command: Sequence[str], folder: Path) -> None:
    """Run the C compiler in a directory; BuildError with its first error if it fails."""
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    except OSError as error:
        raise BuildError(f"the C compiler cannot be called: {error}") from error
    if done.returncode:
        found = [line for line in done.stderr.splitlines() if "error" in line]
        reason = found[0] if found else _last_line(done.stderr) or f"exit code {done.returncode}"
        advice = "; install the package with Python's headers, python3-dev" if "Python.h" in reason else ""
        raise BuildError(f"the C compiler failed: {reason}{advice}")


def _compiler() -> list[str]:
    """Return the command of the C compiler."""
    if given := os.environ.get("CC"):
        return shlex.split(given)
    for name in COMPILERS:
        if found := shutil.which(name):
            return [found]
    raise BuildError(f"no C compiler was found ({', '.join(COMPILERS)})")


def _last_line(text: str) -> str:
    return next((line for line in reversed(text.splitlines()) if line.strip()), "")
