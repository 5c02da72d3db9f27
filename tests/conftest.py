"""Configuration of all tests: the search of property tests, and the folder of real maps.

A default run tries 30 examples of each property, the same ones every time. ``pytest -m long`` also runs all property
tests, with 300 examples from a fresh random seed; a failure prints the example that reproduces it.
``MURMUR_HYPOTHESIS=thorough`` tries 3000 examples.
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import tempfile
from multiprocessing import util
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from protocol.temporary import temporary_folder

settings.register_profile(
    "default", max_examples=30, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile(
    "thorough", max_examples=3000, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile(
    "fresh", max_examples=300, deadline=None, print_blob=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile(os.environ.get("MURMUR_HYPOTHESIS", "default"))

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Tests that run in the background of a shell would hand down to what they start that it ignores Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the same below ``nohup``


def _selects_long(config: pytest.Config) -> bool:
    """Return whether the marker expression selects tests that are marked `long`."""
    return "long" in config.option.markexpr and "not long" not in config.option.markexpr


_at_end = contextlib.ExitStack()


def pytest_configure(config: pytest.Config) -> None:
    """Search property tests from a fresh seed if long tests are selected; remove all temporary files at the end."""
    if not hasattr(config, "workerinput"):
        # All that is started here puts its files there, too: browsers, viewers, clusters. Not pytest's own directories.
        os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", tempfile.gettempdir())
        os.environ["TMPDIR"] = str(_at_end.enter_context(temporary_folder()))
        tempfile.tempdir = None
        util.Finalize(None, _at_end.close, exitpriority=-300)  # after `deploy.run.parent_watchdog`
    if _selects_long(config) and "MURMUR_HYPOTHESIS" not in os.environ:
        settings.load_profile("fresh")


SLOWEST_FIRST = (
    "tests/system", "tests/deploy", "tests/capture", "tests/protocol", "tests/worldsim", "tests/netshaper", "tests"
)  # fmt: skip
"""Directories, by the duration of their files: the first ones start processes."""


def _speed(item: pytest.Item) -> int:
    """Return the place of a test's directory in `SLOWEST_FIRST`."""
    return next(place for place, folder in enumerate(SLOWEST_FIRST) if item.nodeid.startswith(folder))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Count property tests among the long ones if these are selected; let workers begin with the slowest files."""
    if hasattr(config, "workerinput"):
        items.sort(key=_speed)  # else one worker would wait for the last files of the other
    if _selects_long(config):
        for item in items:
            if getattr(getattr(item, "obj", None), "is_hypothesis_test", False):
                item.add_marker("long")


def pytest_collection_finish() -> None:
    """Exempt all modules and collected tests from garbage collection, which would visit them again and again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def real_maps() -> Path:
    """The folder of the real maps; where it is missing the test is skipped."""
    folder = Path(os.environ.get("MURMUR_MAPS", Path(__file__).parents[2] / "shared" / "maps"))
    if not folder.is_dir():
        pytest.skip(f"no folder {folder}: set MURMUR_MAPS to the folder of the real maps")
    return folder
