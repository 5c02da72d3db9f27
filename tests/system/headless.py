"""Rerun's viewer without a screen: it opens a recording, reports its views' errors, and takes a screenshot."""

from __future__ import annotations

import contextlib
import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from deploy.dashboard.windows import LOOPBACK, QUIET, binary, free_port

DRIVERS = (Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d"))
PATIENCE_S = 60.0


@contextlib.contextmanager
def viewer(recording: Path, size: str = "1920x1080") -> Iterator[Any]:
    """A client of a viewer that has opened the recording."""
    rerun = pytest.importorskip("rerun", reason="Rerun is not installed: pip install 'murmur-robots[view]'")
    if not any(folder.glob("*.json") for folder in DRIVERS if folder.is_dir()):
        pytest.skip("no Vulkan driver: install Debian's package mesa-vulkan-drivers to draw without a screen")
    port = free_port()
    flags = ["--headless", "--bind", LOOPBACK, "--port", str(port), "--window-size", size]
    process = subprocess.Popen(
        [binary(), *flags, "--hide-welcome-screen", recording],
        env=os.environ | QUIET,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        del rerun
        yield _connect(process, port)
    finally:
        process.terminate()
        process.wait()


def _connect(process: subprocess.Popen[bytes], port: int) -> Any:
    from rerun.experimental import ViewerClient

    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            client = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
            state = client.get_state()
            lines = [line.name for recording in state.recordings for line in recording.timelines]
            if state.views and "step" in lines and not state.loading:
                return client
        except Exception as error:  # whatever it raises while it starts
            assert process.poll() is None, f"the viewer has ended ({process.returncode}): {error}"
        assert time.monotonic() < deadline, f"the viewer shows nothing after {PATIENCE_S:g} s"
        time.sleep(0.2)


def settled_picture(client: Any, step: int) -> bytes:
    """The dashboard at a step, once two pictures in a row are alike."""
    client.set_time("step", sequence=step, play_state="paused")
    deadline = time.monotonic() + PATIENCE_S
    last = b""
    while time.monotonic() < deadline:
        time.sleep(0.7)
        now: bytes = client.take_screenshot()
        if now == last and not client.get_state().loading:
            return now
        last = now
    raise AssertionError(f"the dashboard has not settled within {PATIENCE_S:g} s")
