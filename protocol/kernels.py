"""Compilation of hot loops by numba.

A kernel has one signature, given by the types of its parameters (`protocol.arrays`). The first call compiles it, or
reads it from numba's cache, so that commands which compute nothing do not import numba. If a kernel is not in the
cache, all imported kernels are compiled at once: this takes a minute, once per installation, and the error stream
shows the progress. `murmur setup` does it with several processes. The fork server loads all kernels in one process
(`deploy.run.preload`), so robots never compile. Fastmath is off: equal versions of the libraries give equal bits on
every machine.

The cache is ``__pycache__`` beside each module. If this cannot be written, it is in the user's cache directory, or in
``NUMBA_CACHE_DIR``. If no directory can be written, each process compiles the kernels again.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import cache, cached_property, update_wrapper
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

Function = TypeVar("Function", bound=Callable[..., Any])


class Kernel:
    """A function that the first call compiles for one signature."""

    def __init__(self, function: Callable[..., Any]) -> None:
        update_wrapper(self, function)
        self.function = function
        self.was_cached = False
        """Whether it was read from numba's cache; False until it is loaded."""
        self.cache = ""
        """Directory of numba's cache that has it; empty until it is loaded, or if no directory can be written."""
        self._modules: list[tuple[Any, bytes]] = []
        """The library of the compiled function and its LLVM module as bitcode (`_release_modules`)."""

    def __call__(self, *args: Any) -> Any:
        """Call the compiled function."""
        return self.loaded(*args)

    @cached_property
    def loaded(self) -> Any:
        """The compiled function. It replaces this object in its module, so that later calls are direct."""
        check_compiler()
        try:
            dispatcher = _numba().njit(cache=True, error_model="numpy")(self.function)
        except RuntimeError:  # the cache has no directory that can be written
            dispatcher = _numba().njit(error_model="numpy")(self.function)
        with _before_compiling(dispatcher, self._prepare):
            try:
                dispatcher.compile(self._signature)
            except OSError:
                if not dispatcher.signatures:  # else it is compiled, and only the cache cannot be written
                    raise
        dispatcher.disable_compile()
        self.was_cached = bool(dispatcher.stats.cache_hits)
        self.cache = dispatcher.stats.cache_path or ""
        self._replace(self.function.__name__, dispatcher)
        vars(self)["loaded"] = dispatcher
        if self.was_cached:
            self._release_modules()
        else:
            _compilation.finish_one()
        return dispatcher

    @property
    def is_loaded(self) -> bool:
        """Whether it is compiled or read from the cache."""
        return "loaded" in vars(self)

    @property
    def package(self) -> str:
        """Its package, or its module if that is in no package."""
        module = self.function.__module__
        return module.rpartition(".")[0] or module

    @property
    def _signature(self) -> str:
        """The signature in numba's notation."""
        *parameters, result = map(_numba_type, get_type_hints(self.function, include_extras=True).values())
        return f"{result}({', '.join(parameters)})"

    def restore_modules(self) -> None:
        """Parse the LLVM modules again, which the compilation of a caller links."""
        parse_bitcode = importlib.import_module("llvmlite.binding").parse_bitcode
        while self._modules:
            library, bitcode = self._modules.pop()
            library._shared_module = parse_bitcode(bitcode)

    def _release_modules(self) -> None:
        """Keep LLVM modules of the compiled function as bitcode, which takes a seventh of the memory."""
        for each in self.loaded.overloads.values():
            module = getattr(each.library, "_shared_module", None)
            if module is not None:
                self._modules.append((each.library, module.as_bitcode()))
                each.library._shared_module = None

    def _prepare(self) -> None:
        """Load the kernels that it calls before numba compiles it."""
        _compilation.begin(self.package)
        for name in self.function.__code__.co_names:
            called = self.function.__globals__.get(name)
            if isinstance(called, Kernel):
                self._replace(name, called.loaded)
        for each in _kernels:
            each.restore_modules()

    def _replace(self, name: str, dispatcher: Any) -> None:
        """Replace the kernel called `name` in this module by its compiled function."""
        if isinstance(self.function.__globals__.get(name), Kernel):
            self.function.__globals__[name] = dispatcher


SELDOM = 10
"""Compiled kernels between two lines of progress without a terminal."""

NO_CACHE = "numba's cache cannot be written: set NUMBA_CACHE_DIR to a writable directory, or each start compiles again"
"""Warning if no directory for compiled kernels can be written."""

_kernels: list[Kernel] = []


def kernel(function: Function) -> Function:
    """Compile the decorated function at its first call; its annotations give the signature (`protocol.arrays`)."""
    _kernels.append(Kernel(function))
    return cast("Function", _kernels[-1])


_SCALARS = {int: "int64", float: "float64", bool: "boolean", type(None): "void"}


def _numba_type(hint: Any) -> str:
    """Return an annotation in numba's notation, which ``Annotated`` types carry as their metadata."""
    if get_origin(hint) is Annotated:
        return str(hint.__metadata__[0])
    if get_origin(hint) is tuple:
        return f"Tuple(({', '.join(map(_numba_type, get_args(hint)))},))"
    return _SCALARS[hint]


def check_compiler() -> None:
    """Raise ValueError if the environment forbids numba to compile."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0").strip() not in ("", "0"):
        raise ValueError(
            "NUMBA_DISABLE_JIT is set, but kernels must be compiled: unset this environment variable"
        )


def load_all() -> None:
    """Load all imported kernels; compile those that are not in the cache."""
    for each in _kernels:
        _ = each.loaded


def compile_in_parallel(jobs: int) -> int:
    """Put all imported kernels into the cache, by `jobs` processes; return how many they compiled.

    This process does not load them. If the cache cannot be written, the work ends early.
    """
    count, number = 0, len(_kernels)
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("fork")) as pool:
        for done, (was_compiled, is_kept) in enumerate(pool.map(_put_into_cache, range(number)), 1):
            if not is_kept:
                pool.shutdown(cancel_futures=True)
                break
            count += was_compiled
            if was_compiled and (_is_terminal() or count % SELDOM == 1):
                _print(f"compiling for this machine, once: {done} of {number} kernels")
    if count:
        _print(f"compiled {count} kernels", last=True)
    return count


def _put_into_cache(number: int) -> tuple[bool, bool]:
    """Load a kernel in a process for this; return whether it was compiled, and whether it is in the cache now."""
    _compilation.is_single = True
    each = _kernels[number]
    _ = each.loaded
    return not each.was_cached, bool(each.cache)


def loaded() -> int:
    """Return the number of kernels that this process read from the cache."""
    return sum(each.was_cached for each in _kernels)


def compiled() -> int:
    """Return the number of kernels that this process compiled."""
    return sum(each.is_loaded and not each.was_cached for each in _kernels)


def compilation_s() -> float:
    """Return the seconds that this process has spent compiling kernels."""
    return _compilation.seconds


def cache_folder() -> str:
    """Return the directory that contains the caches of all loaded kernels; empty if no directory can be written."""
    caches = {each.cache for each in _kernels if each.is_loaded}
    return os.path.commonpath(caches) if caches and "" not in caches else ""


class _Compilation:
    """Compilation of all kernels at once; prints its progress to the error stream."""

    def __init__(self) -> None:
        self.seconds = 0.0
        """Duration of all compilations so far."""
        self.is_single = False
        """Whether to compile only kernels that are called, and print nothing."""
        self._depth = 0
        """Kernels being compiled: a kernel, those that it calls, and so on."""
        self._began = 0.0
        self._package = ""

    def begin(self, package: str) -> None:
        """Report that a kernel of `package` comes next: on a terminal for each kernel, else once per package."""
        if self._depth == 0:
            self._began = time.perf_counter()
        self._depth += 1
        done = sum(each.is_loaded for each in _kernels)
        if not self.is_single and (package != self._package or _is_terminal()):
            _print(f"compiling for this machine, once: {done} of {len(_kernels)} kernels, now {package}")
        self._package = package

    def finish_one(self) -> None:
        """After a kernel that no other kernel waits for, compile all remaining ones."""
        if self._depth == 1 and not self.is_single:
            load_all()
            _print(f"compiled {compiled()} kernels", last=True)
            if not cache_folder():
                _print(NO_CACHE, last=True)
            self.seconds += time.perf_counter() - self._began
        self._depth -= 1


_compilation = _Compilation()


def _is_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


def _print(text: str, *, last: bool = False) -> None:
    """Print a line to the error stream; on a terminal it overwrites the line before, until the `last` one."""
    if sys.stderr is not None:
        over = _is_terminal()
        end = "\n" if last or not over else ""
        print(f"\r{text:<76}" if over else text, end=end, file=sys.stderr, flush=True)


@cache
def _numba() -> Any:
    """Import numba without scipy.linalg, which takes 18 MB, and which only np.cov and np.corrcoef need in kernels."""
    import numba  # noqa: PLC0415  takes half a second, which only computing commands need

    linear_algebra = "scipy.linalg"
    if linear_algebra not in sys.modules:
        sys.modules[linear_algebra] = None  # type: ignore[assignment] # so its import fails
        try:
            importlib.import_module("numba.np.arraymath")
        finally:
            del sys.modules[linear_algebra]
    return numba


@contextmanager
def _before_compiling(dispatcher: Any, act: Callable[[], object]) -> Iterator[None]:
    """Call `act` when numba starts to compile `dispatcher`, which it does not if the cache has it."""
    from numba.core import event  # noqa: PLC0415

    class Listener(event.Listener):  # type: ignore[misc]
        def on_start(self, event: Any) -> None:
            if event.data["dispatcher"] is dispatcher:
                act()

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield
