"""`murmur watch`: view a run in progress, or the recording of one.

A run in progress writes ``live.json`` for viewers: the credential (readable by its owner only), and the port at which
its own viewer serves the recording from the beginning, if it has one.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from deploy.dashboard.process import RECORDING, ViewTask, serve
from deploy.dashboard.windows import Window
from deploy.record import run_directory
from deploy.scenario.errors import ScenarioError
from protocol.files import read_file
from protocol.zenoh_bus import Credential
from worldsim.atomic_files import naming

LIVE = "live.json"
POLL_S = 0.5


@contextlib.contextmanager
def announced(directory: Path | None, credential: Credential, port: int | None) -> Iterator[None]:
    """Keep ``live.json`` in the run directory while the run is in progress."""
    if directory is None:
        yield
        return
    path = directory / LIVE
    try:
        with naming(path):
            handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                json.dump(asdict(credential) | {"port": port}, file, indent=2)
        yield
    finally:
        path.unlink(missing_ok=True)


def read_live(directory: Path) -> tuple[Credential, int | None] | None:
    """Read the credential and the port in ``live.json``; None if no run is in progress.

    The file may be left over from a killed run.

    Raises ValueError if the file is damaged.
    """
    path = directory / LIVE
    if not path.is_file():
        return None
    credential = Credential.read(path)
    host, _, hub_port = credential.hub.partition("/")[2].rpartition(":")
    try:
        socket.create_connection((host, int(hub_port)), timeout=1.0).close()
    except OSError:
        return None
    return credential, json.loads(read_file(path)).get("port")


def watch(directory: Path, window: Window) -> None:
    """View a run: live from now on, or from the beginning if it has its own viewer; else its recording.

    Returns when the run is over, or when the page is closed.

    Raises ScenarioError if there is neither a run in progress nor a recording, or if a finished run is to be recorded.
    """
    live = read_live(directory)
    if live is None:
        recording = recording_of(directory)
        if window.mode == "file":
            raise ScenarioError(
                f"view-as = 'file': {recording} is complete; use 'native' or 'web' to view it"
            )
        _show(recording, window)
        return
    credential, port = live
    if port is not None:
        window.port = port
        window.open()
        if window.mode != "native":
            while read_live(directory) is not None:
                time.sleep(POLL_S)
            _show(recording_of(directory), window)
    else:
        task = ViewTask(run_directory.read_plan(directory), directory, port=window.port)
        ended = serve(credential, task, window.open)
        if ended and window.mode != "native":
            _show(recording_of(directory), window)


def keep_showing(directory: Path, window: Window) -> None:
    """Once a run is over, serve its recording at the same address until Ctrl-C, so that the page stays available."""
    if window.mode == "web":
        _show(recording_of(directory), window)


def recording_of(directory: Path) -> Path:
    """The newest recording in a run directory; ScenarioError if there is none."""
    stem, suffix = RECORDING.split(".")
    found = sorted(directory.glob(f"{stem}*.{suffix}"), key=lambda path: path.stat().st_mtime_ns)
    if not found:
        raise ScenarioError(
            f"{directory}: no recording ({RECORDING}), and no run in progress; "
            "murmur explore --view, or --view-as file, records one"
        )
    return found[-1]


def _show(recording: Path, window: Window) -> None:
    window.open(recording)
    window.wait()
