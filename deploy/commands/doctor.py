"""`murmur doctor`: check the installation. Each check prints its finding, and advice if it failed."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console
from rich.text import Text

Check = tuple[str, Callable[[], str]]


def examine(screen: Console) -> bool:
    """Run all checks and print their findings; return whether all passed."""
    passed = True
    for name, check in _checks():
        try:
            screen.print(Text.assemble(("ok", "green"), f"     {name}: {check()}"))
        except Exception as error:
            passed = False
            screen.print(Text.assemble(("failed", "red"), f" {name}: {error}"))
    return passed


def _checks() -> Iterator[Check]:
    yield "python", _python
    yield "packages", _packages
    yield "kernels", _kernels
    yield "swarm on the memory bus", lambda: _swarm("memory")
    yield "swarm on Zenoh", lambda: _swarm("zenoh")
    yield "viewer", _viewer


def _python() -> str:
    return platform.python_version()


def _packages() -> str:
    from deploy.record.versions import versions  # noqa: PLC0415

    return ", ".join(f"{name} {version}" for name, version in versions().items() if name != "python")


def _kernels() -> str:
    """Check that kernels come from the cache: compiling them would delay a robot's first step."""
    import deploy.run.preload  # noqa: F401, PLC0415
    from protocol.kernels import compiled, loaded  # noqa: PLC0415

    if loaded() == 0:
        raise RuntimeError(
            f"no cache: all {compiled()} kernels were compiled again; set NUMBA_CACHE_DIR to a writable folder"
        )
    return f"{loaded()} loaded from the cache, {compiled()} compiled now"


def _swarm(bus: str) -> str:
    from deploy.run import exploration  # noqa: PLC0415
    from deploy.scenario.scenario import parse  # noqa: PLC0415

    scenario = parse({"map": "em", "robots": 2, "bus": bus, "steps": 30})
    with TemporaryDirectory() as folder:
        result = exploration.explore(scenario, out=Path(folder) / "run")
    if result.deaths or result.records.lost:
        raise RuntimeError(f"processes died: {result.deaths or result.records.lost}")
    return f"{result.summary['steps']} steps, {result.summary['steps_per_s']} steps/s"


def _viewer() -> str:
    import importlib.util  # noqa: PLC0415

    if importlib.util.find_spec("rerun") is None:
        return "not installed; --view needs it: pip install 'murmur-robots[view]'"
    return "Rerun installed"
