"""Windows that show a run: Rerun's viewer, or a web page with it, in a separate process on the loopback.

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
from typing import TYPE_CHECKING, Any

from deploy.dashboard.access import LOOPBACK, Access, local_network_address

if TYPE_CHECKING:
    from deploy.dashboard.page import Page, Panel

MODES = ("auto", "native", "web", "file")
"""Types of viewer: a window, a web page, or recording only; ``auto`` is a window, or a page without a display."""
PAGE_S = 10.0
"""Seconds in which the page must answer."""
DISPLAY_S = 2.0
"""Seconds in which a display must answer."""
X11_PORT = 6000
"""Port of display 0 of an X server; display 1 has the next one."""

QUIET = {"CI": "true"}
"""Environment in which Rerun sends no statistics."""


class WindowError(ValueError):
    """The run cannot be shown: the message names the missing package or display."""


class Window:
    """One run's window: created before the run, opened once there is something to show.

    `mode` is one of `MODES`; `tell` is called with the address once the page is available. `panel` is what the buttons
    of the page control. `share` serves the page on the local network instead of the loopback. `when_seen` is called
    once the page has a viewer.

    Raises WindowError if Rerun is not installed, a window is requested where there is no display, or there is no page
    to share.
    """

    def __init__(
        self,
        mode: str,
        tell: Callable[[str], object] = lambda _: None,
        *,
        panel: Panel | None = None,
        share: bool = False,
        when_seen: Callable[[], object] = lambda: None,
    ) -> None:
        if mode not in MODES:
            raise WindowError(f"view-as = {mode!r}: must be one of {', '.join(MODES)}")
        binary()
        if mode == "native" and not has_display():
            raise WindowError("view-as = 'native': no display answers; use 'web', or 'file' to record only")
        self.mode = mode if mode != "auto" else "native" if has_display() and not share else "web"
        if share and self.mode != "web":
            raise WindowError(f"share: there is no page with view-as = {mode!r}; use --view-as web")
        self.port = None if self.mode == "file" else free_port()
        """Port at which the recording is served during the run."""
        self._panel = panel
        self._when_seen = when_seen
        self._access = Access(local_network_address() if share else LOOPBACK)
        self._page: Page | None = None
        self._viewer: subprocess.Popen[bytes] | None = None
        self._tell = tell

    @property
    def address(self) -> str:
        """The page's address with the token to control the run; empty if no page is open."""
        return self._page.url(controls=True) if self._page is not None else ""

    def open(self, recording: Path | None = None) -> None:
        """Show the run that is served at `port`, or a recording; the page keeps its address."""
        source = self._source if recording is None else str(recording)
        if self.mode == "native":
            _start("--port", "auto", "--hide-welcome-screen", source, apart=True)
        elif self.mode == "web":
            assert self.port is not None
            self._close_viewer()
            # New ports: a server that has just ended, in this process or another one, may still keep its own.
            viewer_port, data_port = free_port(), free_port()
            flags = ["--serve-web", "--web-viewer-port", str(viewer_port), "--port", str(data_port)]
            self._viewer = _start(*flags, source)
            if _answers(self._viewer, viewer_port):
                self._serve(viewer_port, self.port if recording is None else data_port)
            else:
                self._tell("Rerun's page did not start; the run is only recorded")

    def wait(self) -> None:
        """Keep the page open until Ctrl-C, or until its viewer's server ends."""
        if self._viewer is not None:
            self._tell("The page stays open; press Ctrl-C to end.")
            try:
                self._viewer.wait()
            except KeyboardInterrupt:
                self.close()

    def close(self) -> None:
        """Close the page; Rerun's window stays open."""
        self._close_viewer()
        if self._page is not None:
            self._page.close()
        self._page = None

    @property
    def _source(self) -> str:
        return f"rerun+http://{LOOPBACK}:{self.port}/proxy"

    def _serve(self, *ports: int) -> None:
        """Serve the page, with the viewer and the data at ports of Rerun's servers."""
        from deploy.dashboard.page import Page  # noqa: PLC0415  a web server, which few runs need

        if self._page is not None:
            self._page.ports = ports
            return
        self._page = Page(self._access, ports, self._panel, self._when_seen)
        if self._access.address == LOOPBACK:
            self._tell(f"Dashboard: {self.address}")
        else:
            self._tell(f"Dashboard for you: {self.address}")
            self._tell(f"Dashboard for others, only to watch: {self._page.url(controls=False)}")

    def _close_viewer(self) -> None:
        if self._viewer is not None and self._viewer.poll() is None:
            self._viewer.terminate()
            try:
                self._viewer.wait(2.0)
            except subprocess.TimeoutExpired:
                self._viewer.kill()
                self._viewer.wait()
        self._viewer = None


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
    """Whether a window could be opened: on Linux, whether the server of the display answers."""
    if sys.platform in ("win32", "darwin"):
        return True
    return _has_wayland(os.environ.get("WAYLAND_DISPLAY", "")) or _has_x11(os.environ.get("DISPLAY", ""))


def _has_wayland(name: str) -> bool:
    folder = Path(os.environ.get("XDG_RUNTIME_DIR", ""))
    return bool(name) and _takes_connections(socket.AF_UNIX, str(folder / name))


def _has_x11(name: str) -> bool:
    """Whether the X server `name` answers, as ``:0``, ``unix:0.1``, or ``host:10``."""
    host, _, number = name.rpartition(":")
    number = number.partition(".")[0]
    if not number.isdecimal():
        return False
    if host not in ("", "unix"):
        return _takes_connections(socket.AF_INET, (host, X11_PORT + int(number)))
    path = f"/tmp/.X11-unix/X{number}"
    return any(_takes_connections(socket.AF_UNIX, place) for place in (path, f"\0{path}"))


def _takes_connections(family: socket.AddressFamily, place: Any) -> bool:
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.settimeout(DISPLAY_S)
        try:
            probe.connect(place)
        except (OSError, OverflowError):  # OverflowError: no such port
            return False
    return True


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
