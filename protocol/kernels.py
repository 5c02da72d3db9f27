"""Compilation of hot loops by numba.

A kernel has one signature, given by the types of its parameters (`protocol.arrays`). `murmur setup` compiles all
kernels into a library (`protocol.native`). At its first call, a kernel is taken from there, if its code has not
changed since. This needs neither numba nor LLVM.

Otherwise numba compiles the kernel, or reads it from its own cache. If a kernel is in neither, all imported kernels
are compiled at once: this takes a minute, once per installation, and the error stream shows the progress. Without a C
compiler, `murmur setup` fills the cache with several processes. The fork server loads all kernels in one process
(`deploy.run.preload`), so robots never compile. Fastmath is off: equal versions of the libraries give equal bits on
every machine, and the library and the cache have the same code.

A call of a kernel by a kernel counts the references of all arrays among its arguments, also of those in tuples. This
may take longer than a short kernel's work, so a kernel with many arrays should contain the loop that would call it.

The cache is ``__pycache__`` beside each module. If this cannot be written, it is in the user's cache directory, or in
``NUMBA_CACHE_DIR``. If no directory can be written, each process compiles the kernels again.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import cached_property, update_wrapper
from inspect import get_annotations
from types import FunctionType
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin

from protocol.native import library
from protocol.native.digest import digest_of
from protocol.numba_import import check_compiler, import_numba

Function = TypeVar("Function", bound=Callable[..., Any])


class Kernel:
    """A function that is compiled for one signature, at the latest by the first call."""

    def __init__(self, function: FunctionType, number: int) -> None:
        update_wrapper(self, function)
        self.function = function
        self.number = number
        """Its place among all kernels."""
        self.was_compiled = False
        """Whether this process compiled it."""
        self.cache = ""
        """Directory from which it was read, or to which it was written; empty if there is none."""
        self._modules: list[tuple[Any, bytes]] = []
        """The library of the compiled function and its LLVM module as bitcode (`_release_modules`)."""

    def __call__(self, *args: Any) -> Any:
        """Call the compiled function, and replace this object in the module of the caller, which has imported it."""
        compiled, importer = self.loaded, sys._getframe(1).f_globals
        if importer.get(self.function.__name__) is self:
            importer[self.function.__name__] = compiled
        return compiled(*args)

    @cached_property
    def loaded(self) -> Any:
        """The compiled function. It replaces this object in its module, so that later calls are direct."""
        check_compiler()
        native = library.find(self.digest)
        if native is None:
            return self.dispatcher
        self.cache = str(library.folder())
        self._install(native)
        return native

    @cached_property
    def dispatcher(self) -> Any:
        """The function that numba compiled, or read from its cache."""
        try:
            dispatcher = import_numba().njit(cache=True, error_model="numpy")(self.function)
            _add_to_key(dispatcher._cache, self.digest)
        except RuntimeError:  # the cache has no directory that can be written
            _compilation.warn_of_no_cache()
            dispatcher = import_numba().njit(error_model="numpy")(self.function)
        with _before_compiling(dispatcher, self._prepare):
            try:
                dispatcher.compile(self.signature)
            except OSError:
                if not dispatcher.signatures:  # else it is compiled, and only the cache cannot be written
                    raise
        dispatcher.disable_compile()
        self.was_compiled = not dispatcher.stats.cache_hits
        self.cache = dispatcher.stats.cache_path or ""
        vars(self)["dispatcher"] = dispatcher  # before the callers are compiled
        _installed[id(dispatcher)] = self  # modules of callers may hold it, not the library's function
        if not self.is_loaded:
            self._install(dispatcher)
        if self.was_compiled:
            _compilation.finish_one()
        else:
            self._release_modules(dispatcher)
        return dispatcher

    @property
    def is_loaded(self) -> bool:
        """Whether it is compiled, or read from the library or the cache."""
        return "loaded" in vars(self)

    @property
    def package(self) -> str:
        """Its package, or its module if that is in no package."""
        module = self.function.__module__
        return module.rpartition(".")[0] or module

    @cached_property
    def signature(self) -> str:
        """The signature in numba's notation."""
        *parameters, result = map(_numba_type, get_annotations(self.function, eval_str=True).values())
        return f"{result}({', '.join(parameters)})"

    @cached_property
    def called(self) -> dict[str, Kernel]:
        """The kernels that it calls, by the names that it has for them."""
        found = {name: self.function.__globals__.get(name) for name in self.function.__code__.co_names}
        kernels = {
            name: each if isinstance(each, Kernel) else _installed.get(id(each))
            for name, each in found.items()
        }
        return {name: each for name, each in kernels.items() if each is not None}

    @cached_property
    def digest(self) -> str:
        """Digest of what determines its machine code; empty if it cannot be in the library."""
        called = {name: each.digest for name, each in self.called.items()}
        return digest_of(self.function, self.signature, called)

    def restore_modules(self) -> None:
        """Parse the LLVM modules again, which the compilation of a caller links."""
        parse_bitcode = importlib.import_module("llvmlite.binding").parse_bitcode
        while self._modules:
            compiled, bitcode = self._modules.pop()
            compiled._shared_module = parse_bitcode(bitcode)

    def _release_modules(self, dispatcher: Any) -> None:
        """Keep LLVM modules of the compiled function as bitcode, which takes a seventh of the memory."""
        for each in dispatcher.overloads.values():
            module = getattr(each.library, "_shared_module", None)
            if module is not None:
                self._modules.append((each.library, module.as_bitcode()))
                each.library._shared_module = None

    def _prepare(self) -> None:
        """Load the kernels that it calls before numba compiles it, which must find its own functions there."""
        _compilation.begin(self.package)
        for name, called in self.called.items():
            self.function.__globals__[name] = called.dispatcher
        for each in _kernels:
            each.restore_modules()

    def _install(self, compiled: Any) -> None:
        """Replace this kernel by its compiled function in its module."""
        vars(self)["loaded"] = compiled
        _installed[id(compiled)] = self
        module = self.function.__globals__
        if module.get(self.function.__name__) is self:
            module[self.function.__name__] = compiled


SELDOM = 10
"""Turns from one line of progress to the next without a terminal."""

NO_CACHE = "numba's cache cannot be written: set NUMBA_CACHE_DIR to a writable directory, or each start compiles again"
"""Warning if no directory for compiled kernels can be written."""

_kernels: list[Kernel] = []
_installed: dict[int, Kernel] = {}
"""Loaded kernels by the identity of their compiled function."""


def kernel(function: Function) -> Function:
    """Compile the decorated function at its first call; its annotations give the signature (`protocol.arrays`)."""
    _kernels.append(Kernel(cast("FunctionType", function), len(_kernels)))
    return cast("Function", _kernels[-1])


def all_kernels() -> Sequence[Kernel]:
    """Return all kernels of imported modules."""
    return _kernels


_SCALARS = {int: "int64", float: "float64", bool: "boolean", None: "void"}


def _numba_type(hint: Any) -> str:
    """Return an annotation in numba's notation, which ``Annotated`` types carry as their metadata."""
    if get_origin(hint) is Annotated:
        return str(hint.__metadata__[0])
    if get_origin(hint) is tuple:
        return f"Tuple(({', '.join(map(_numba_type, get_args(hint)))},))"
    return _SCALARS[hint]


def load_all() -> None:
    """Load all imported kernels; compile those that are neither in the library nor in the cache."""
    for each in _kernels:
        _ = each.loaded


def compile_in_parallel(jobs: int) -> int:
    """Put imported kernels that are not in the library into numba's cache; return how many were compiled.

    `jobs` processes do this; this process does not load them. If the cache cannot be written, the work ends early.
    """
    missing = [each.number for each in _kernels if library.find(each.digest) is None]
    count = 0
    if missing:
        with ProcessPoolExecutor(jobs, multiprocessing.get_context("fork")) as pool:
            for done, (was_compiled, is_kept) in enumerate(pool.map(_put_into_cache, missing), 1):
                if not is_kept:
                    pool.shutdown(cancel_futures=True)
                    break
                count += was_compiled
                if was_compiled:
                    report_progress(done, len(missing), count)
    if count:
        report_compiled(count)
    return count


def report_progress(done: int, number: int, turn: int) -> None:
    """Print how many of `number` kernels are done: on a terminal at each turn, from 1, else at every tenth."""
    if _is_terminal() or turn % SELDOM == 1:
        _print(f"compiling for this machine, once: {done} of {number} kernels")


def report_compiled(count: int) -> None:
    """Print how many kernels have been compiled, after the last of them."""
    _print(f"compiled {count} kernels", last=True)


def _put_into_cache(number: int) -> tuple[bool, bool]:
    """Load a kernel in a process for this; return whether it was compiled, and whether it is in the cache now."""
    _compilation.is_single = True
    each = _kernels[number]
    _ = each.loaded
    return each.was_compiled, bool(each.cache)


def loaded() -> int:
    """Return the number of kernels that this process read from the library or from the cache."""
    return sum(each.is_loaded and not each.was_compiled for each in _kernels)


def compiled() -> int:
    """Return the number of kernels that this process compiled."""
    return sum(each.was_compiled for each in _kernels)


def compilation_s() -> float:
    """Return the seconds that this process has spent compiling kernels."""
    return _compilation.seconds


def cache_folder() -> str:
    """Return the directory from which all loaded kernels can be read; empty if no directory can be written."""
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
        self._has_warned = False

    def begin(self, package: str) -> None:
        """Report that a kernel of `package` comes next: on a terminal for each kernel, else once per package."""
        if self._depth == 0:
            self._began = time.perf_counter()
        self._depth += 1
        done = sum(each.is_loaded for each in _kernels)
        if not self.is_single and (package != self._package or _is_terminal()):
            _print(f"compiling for this machine, once: {done} of {len(_kernels)} kernels, now {package}")
        self._package = package

    def warn_of_no_cache(self) -> None:
        """Report that compiled kernels cannot be kept: once, and if it is known, before the work that is lost."""
        if not self.is_single and not self._has_warned:
            self._has_warned = True
            _print(NO_CACHE, last=True)

    def finish_one(self) -> None:
        """After a kernel that no other kernel waits for, compile all remaining ones."""
        if self._depth == 1 and not self.is_single:
            load_all()
            report_compiled(compiled())
            if not cache_folder():
                self.warn_of_no_cache()
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


def _add_to_key(cache: Any, digest: str) -> None:
    """Let numba's cache of a function also depend on `digest`: called kernels may be in other modules."""
    key_of = cache._index_key
    cache._index_key = lambda signature, codegen: (*key_of(signature, codegen), digest)


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
