"""Windows that show a run: Rerun's viewer, or its web page; always on the loopback, in a separate process.

This module locates Rerun but does not import it, so that the command line starts quickly, and names the package to
install if it is missing. Rerun's usage statistics are disabled.
"""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlencode

LOOPBACK = "127.0.0.1"
MODES = ("auto", "native", "web", "file")
"""Types of viewer: a window, a web page, or recording only; ``auto`` is a window, or a page without a display."""
PAGE_S = 10.0
"""Seconds in which the page must answer."""

QUIET = {"CI": "true"}
"""Environment in which Rerun sends no statistics."""


class WindowError(ValueError):
    """The run cannot be shown: the message names the missing package or display."""


class Window:
    """One run's window: created before the run, opened once there is something to show.

    `mode` is one of `MODES`; `tell` is called with the address once the page is available.

    Raises WindowError if Rerun is not installed, or a window is requested where there is no display.
    """

    def __init__(self, mode: str, tell: Callable[[str], object] = lambda _: None) -> None:
        if mode not in MODES:
            raise WindowError(f"view-as = {mode!r}: must be one of {', '.join(MODES)}")
        binary()
        if mode == "native" and not has_display():
            raise WindowError("view-as = 'native': no display; use 'web', or 'file' to record only")
        self.mode = mode if mode != "auto" else "native" if has_display() else "web"
        self.port = None if self.mode == "file" else free_port()
        """Port at which the recording is served during the run."""
        self._page_port = free_port() if self.mode == "web" else None
        self._page: subprocess.Popen[bytes] | None = None
        self._tell = tell

    @property
    def address(self) -> str:
        """The page's address, or empty if there is no page."""
        query = urlencode({"url": self._source, "hide_welcome_screen": "1"})
        return f"http://{LOOPBACK}:{self._page_port}/?{query}" if self._page_port else ""

    def open(self, recording: Path | None = None) -> None:
        """Show the run that is served at `port`, or a recording, which the page itself then serves there."""
        source = self._source if recording is None else str(recording)
        if self.mode == "native":
            _start("--port", "auto", "--hide-welcome-screen", source, apart=True)
        elif self.mode == "web":
            self.close()
            flags = ["--serve-web", "--web-viewer-port", str(self._page_port)]
            self._page = _start(*flags, "--port", str(self.port if recording else free_port()), source)
            if _answers(self._page, self._page_port or 0):
                until = "" if recording is None else "  (until Ctrl-C)"
                self._tell(f"Dashboard: {self.address}{until}")
            else:
                self._tell(f"Rerun's page did not start on port {self._page_port}; the run is only recorded")

    @property
    def _source(self) -> str:
        return f"rerun+http://{LOOPBACK}:{self.port}/proxy"

    def wait(self) -> None:
        """Wait until the page closes, or Ctrl-C."""
        if self._page is not None:
            try:
                self._page.wait()
            except KeyboardInterrupt:
                self.close()

    def close(self) -> None:
        """Close the page; Rerun's window stays open."""
        if self._page is not None and self._page.poll() is None:
            self._page.terminate()
            try:
                self._page.wait(2.0)
            except subprocess.TimeoutExpired:
                self._page.kill()
                self._page.wait()
        self._page = None


def binary() -> Path:
    """Rerun's executable; its wrapper would leave the child running when it is terminated."""
    found = importlib.util.find_spec("rerun_cli")
    if found is None or found.origin is None:
        raise WindowError(
            "the dashboard needs Rerun, which is not installed: pip install 'murmur-robots[view]'"
        )
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    return Path(found.origin).parent / name


def has_display() -> bool:
    """Whether a window could be opened."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def optimize(recording: Path) -> None:
    """Rewrite a recording in larger pieces; it stays as it is if that fails."""
    beside = recording.with_name(f".{recording.stem}.part.rrd")
    try:
        done = subprocess.run(
            [binary(), "rrd", "optimize", "--output", beside, recording],
            env=os.environ | QUIET,
            capture_output=True,
            check=False,
        )
        if done.returncode == 0:
            beside.replace(recording)
    finally:
        beside.unlink(missing_ok=True)


def free_port(address: str = LOOPBACK, port: int = 0) -> int:
    """Return a free port of this host: `port` unless that is 0; OSError if it is taken."""
    family, kind, number, _, place = socket.getaddrinfo(address, port, type=socket.SOCK_STREAM)[0]
    with socket.socket(family, kind, number) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(place)
        found: int = probe.getsockname()[1]
        return found


def _start(*arguments: str, apart: bool = False) -> subprocess.Popen[bytes]:
    """Start Rerun; `apart`: it outlives this process and does not get its Ctrl-C."""
    return subprocess.Popen(
        [binary(), "--bind", LOOPBACK, *arguments],
        env=os.environ | QUIET,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=apart,
    )


def _answers(page: subprocess.Popen[bytes], port: int) -> bool:
    deadline = time.monotonic() + PAGE_S
    while page.poll() is None and time.monotonic() < deadline:
        try:
            with socket.create_connection((LOOPBACK, port), timeout=1.0):
                return True
        except OSError:
            time.sleep(0.05)
    return False
