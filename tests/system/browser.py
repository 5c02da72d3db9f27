"""A real browser without a screen, steered over two pipes: enough to open a page and take its picture."""

from __future__ import annotations

import base64
import fcntl
import itertools
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from typing import Any, Self

import pytest

FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--mute-audio", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-default-apps", "--disable-extensions", "--remote-debugging-pipe",
]  # fmt: skip


class Browser:
    """Chromium; a context manager."""

    def __init__(self, width: int, height: int) -> None:
        program = shutil.which("chromium")
        if program is None:
            pytest.skip("no chromium: install Debian's package chromium to see the dashboard in a browser")
        # Helpers of the browser that are killed with it may write for a moment longer.
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        low_in, self._out = os.pipe()
        self._in, low_out = os.pipe()
        theirs_in, theirs_out = (fcntl.fcntl(end, fcntl.F_DUPFD, 20) for end in (low_in, low_out))
        size = f"--window-size={width},{height}"
        # It reads orders from descriptor 3 and answers on 4.
        shell = f'exec "$0" "$@" 3<&{theirs_in} 4>&{theirs_out}'
        self._process = subprocess.Popen(
            ["bash", "-c", shell, program, *FLAGS, size, f"--user-data-dir={self._folder.name}"],
            pass_fds=(theirs_in, theirs_out),
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for end in (low_in, low_out, theirs_in, theirs_out):
            os.close(end)
        self._numbers = itertools.count(1)
        self._buffer = b""
        self._session: str | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        os.close(self._in)
        os.close(self._out)
        self._folder.cleanup()

    def open(self, address: str) -> None:
        """Open a page."""
        page = self._ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._ask("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        self._ask("Page.navigate", url=address)

    def click(self, x: int, y: int) -> None:
        """Click at a pixel of the page."""
        at = {"x": x, "y": y, "button": "left", "clickCount": 1}
        for kind in ("mousePressed", "mouseReleased"):
            self._ask("Input.dispatchMouseEvent", type=kind, **at)

    def evaluate(self, expression: str) -> Any:
        """Return the value of an expression in the page's script, which JSON can represent."""
        answer = self._ask("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def picture(self) -> bytes:
        """The page as it looks now, a PNG."""
        return base64.b64decode(self._ask("Page.captureScreenshot", format="png")["data"])

    def settled_picture(self, seconds: float, least: int) -> bytes:
        """The page once it shows something, of at least so many bytes, and no longer changes."""
        deadline = time.monotonic() + seconds
        last = b""
        while time.monotonic() < deadline:
            time.sleep(2.0)
            now = self.picture()
            if now == last and len(now) >= least:
                return now
            last = now
        raise AssertionError(
            f"the page has not settled within {seconds:g} s; its last picture: {len(last)} bytes"
        )

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        number = next(self._numbers)
        order: dict[str, Any] = {"id": number, "method": method, "params": parameters}
        if self._session is not None:
            order["sessionId"] = self._session
        os.write(self._out, json.dumps(order).encode() + b"\0")
        while True:
            while b"\0" not in self._buffer:
                piece = os.read(self._in, 1 << 20)
                assert piece, "the browser has ended"
                self._buffer += piece
            line, self._buffer = self._buffer.split(b"\0", 1)
            answer = json.loads(line)
            if answer.get("id") == number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                result: dict[str, Any] = answer["result"]
                return result
