"""Compilation of hot loops.

A kernel has an explicit signature. It is compiled, or read from numba's cache, when it is first called: a command that
computes nothing does not wait for numba. The first one that is not in the cache has all that are imported compiled at
once, which takes a minute and happens once an installation; the error stream says how far it is. The fork server loads
all of them in one process (`deploy.run.preload`), so that robots never compile. No fastmath: a kernel gives the same
bits wherever the same versions run.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property, update_wrapper
from typing import Any, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., Any])


class Kernel:
    """A function that is compiled for one signature when it is first called."""

    def __init__(self, function: Callable[..., Any], signature: str) -> None:
        update_wrapper(self, function)
        self.function = function
        self.signature = signature
        self.was_cached = False
        """Whether it has been read from numba's cache; False until it is loaded."""
        self._is_stripped = False

    def __call__(self, *args: Any) -> Any:
        """Call what is compiled."""
        return self.loaded(*args)

    @cached_property
    def loaded(self) -> Any:
        """The compiled function; from now on its module calls it without a detour."""
        import numba  # noqa: PLC0415  half a second, for which only those wait who compute

        dispatcher = numba.njit(cache=True, error_model="numpy")(self.function)
        with _before_compiling(dispatcher, self._prepare):
            dispatcher.compile(self.signature)
        dispatcher.disable_compile()
        self.was_cached = bool(dispatcher.stats.cache_hits)
        self._replace(self.function.__name__, dispatcher)
        vars(self)["loaded"] = dispatcher
        if not self.was_cached:
            _compilation.go_on()
        return dispatcher

    @property
    def is_loaded(self) -> bool:
        """Whether it has been called or loaded."""
        return "loaded" in vars(self)

    @property
    def room(self) -> str:
        """The package that it belongs to, or its module if that is in none."""
        module = self.function.__module__
        return module.rpartition(".")[0] or module

    def strip(self) -> None:
        """Keep nothing but the code that runs: a fourth of the memory."""
        for compiled in self.loaded.overloads.values():
            compiled.library._shared_module = None
        self._is_stripped = True

    def _restore(self) -> None:
        """Read from the cache what others that call it are linked with."""
        again = self.loaded._cache.load_overload(self.signature, self.loaded.targetctx)
        for compiled in self.loaded.overloads.values():
            compiled.library._shared_module = again.library._shared_module
        self._is_stripped = False

    def _prepare(self) -> None:
        """Load the kernels that it calls, for numba to see."""
        _compilation.begin(self.room)
        for each in _kernels:
            if each._is_stripped:
                each._restore()
        for name in self.function.__code__.co_names:
            called = self.function.__globals__.get(name)
            if isinstance(called, Kernel):
                self._replace(name, called.loaded)

    def _replace(self, name: str, dispatcher: Any) -> None:
        """Let the module have what is compiled instead of the kernel."""
        if isinstance(self.function.__globals__.get(name), Kernel):
            self.function.__globals__[name] = dispatcher


_kernels: list[Kernel] = []


def kernel(signature: str) -> Callable[[Function], Function]:
    """Compile the decorated function for `signature` (numba's notation) when it is first called."""

    def keep(function: Function) -> Function:
        _kernels.append(Kernel(function, signature))
        return cast("Function", _kernels[-1])

    return keep


def load_all() -> None:
    """Load all kernels that have been imported; those that are not in the cache are compiled."""
    for each in _kernels:
        _ = each.loaded


def load_code() -> None:
    """Load all kernels, and keep nothing of them but the code that runs; at once, so that they leave no gaps."""
    for each in _kernels:
        each.strip()


def loaded() -> int:
    """How many kernels this process has read from the cache."""
    return sum(each.was_cached for each in _kernels)


def compiled() -> int:
    """How many kernels this process had to compile."""
    return sum(each.is_loaded and not each.was_cached for each in _kernels)


class _Compilation:
    """All kernels compiled at once, after the first that the cache lacks; the error stream says how far it is."""

    def __init__(self) -> None:
        self._open = 0
        self._room = ""

    def begin(self, room: str) -> None:
        """Say that a kernel of `room` comes next: on a terminal in one line, else in one a room."""
        self._open += 1
        done = sum(each.is_loaded for each in _kernels)
        if room != self._room or _is_terminal():
            _print(f"compiling for this machine, once: {done} of {len(_kernels)} kernels, now {room}")
        self._room = room

    def go_on(self) -> None:
        """Compile all others too, once a kernel is done that no other one waits for."""
        if self._open == 1:
            load_all()
            _print(f"compiled {compiled()} kernels", last=True)
        self._open -= 1


_compilation = _Compilation()


def _is_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


def _print(text: str, *, last: bool = False) -> None:
    """Print a line to the error stream; on a terminal over the line before, unless that was the `last`."""
    if sys.stderr is not None:
        over = _is_terminal()
        end = "\n" if last or not over else ""
        print(f"\r{text:<76}" if over else text, end=end, file=sys.stderr, flush=True)


@contextmanager
def _before_compiling(dispatcher: Any, act: Callable[[], object]) -> Iterator[None]:
    """Call `act` when `dispatcher` begins to be compiled, which it does not if it is in the cache."""
    from numba.core import event  # noqa: PLC0415

    class Listener(event.Listener):  # type: ignore[misc]
        def on_start(self, event: Any) -> None:
            if event.data["dispatcher"] is dispatcher:
                act()

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield
