"""The web page of a run: Rerun's viewer below a bar of buttons that control the run (docs/dashboard.md).

The page, the viewer and its data have one address, and all require a token (`deploy.dashboard.access`).
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Sequence
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any, Protocol
from urllib.parse import parse_qs, urlsplit

import msgspec

from deploy.dashboard.access import TOKEN_HEADER, Access
from deploy.dashboard.forwarding import MAX_REQUEST, READ_STREAM, forward

VIEWER = "/viewer/"
MOST_VIEWERS = 64
IDLE_S = 60.0
"""Seconds after which a connection that does not take or send anything is closed."""

_SAFE = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_PAGE_POLICY = (
    "default-src 'self'; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'; form-action 'none'"
)
_VIEWER_POLICY = (
    "default-src 'self' blob: data: 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval'; "
    "connect-src 'self' blob: data:; frame-ancestors 'self'"
)
"""Rerun's viewer compiles WebAssembly, and may load nothing from other hosts."""


class Panel(Protocol):
    """The run that the buttons control."""

    def perform(self, command: str, value: str = "") -> str:
        """Perform a command; return a message, or raise ValueError."""

    def state(self) -> dict[str, Any]:
        """The state of the run."""


class Page:
    """A web server in threads of this process.

    `panel` is what the buttons control; without it there are none. `ports` has those of Rerun's servers for the viewer
    and for the data, on the loopback. `when_seen` is called once a first viewer receives data.
    """

    def __init__(
        self,
        access: Access,
        ports: Sequence[int],
        panel: Panel | None = None,
        when_seen: Callable[[], object] = lambda: None,
    ) -> None:
        self.access = access
        self.ports = ports
        self.panel = panel
        self._when_seen = when_seen
        self._is_seen = False
        self.free_places = threading.BoundedSemaphore(MOST_VIEWERS)
        handler = type("Handler", (_Handler,), {"page": self})
        self._server = _Server((access.address, 0), handler)
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def url(self, *, controls: bool) -> str:
        """The page's address, with the token to control or that to watch."""
        token = self.access.control if controls else self.access.watch
        return f"http://{self.access.address}:{self._server.server_port}/?token={token}"

    def note_viewer(self) -> None:
        """Note that a viewer receives data."""
        if not self._is_seen:
            self._is_seen = True
            self._when_seen()

    def close(self) -> None:
        """Stop the server."""
        self._server.shutdown()
        self._server.server_close()


class _Order(msgspec.Struct):
    command: str
    value: str = ""


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore connections that break off."""


class _Handler(BaseHTTPRequestHandler):
    page: Page
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "Murmur", ""
    timeout = IDLE_S

    def log_message(self, *_: object) -> None:
        """Log no requests."""

    def do_GET(self) -> None:
        url = urlsplit(self.path)
        if not self._is_addressed():
            return
        if url.path == "/":
            self._send_page(parse_qs(url.query).get("token", [""])[0])
        elif not self._may_watch():
            self._refuse(403, "the token is missing: open the address that the terminal shows")
        elif url.path == "/page.js":
            self._send(200, "text/javascript", _file("page.js"))
        elif url.path == "/state":
            self._send_state()
        elif url.path.startswith(VIEWER):
            path = url.path.removeprefix(VIEWER.rstrip("/"))
            policy = _SAFE | {"Content-Security-Policy": _VIEWER_POLICY}
            forward(self, self.page.ports[0], path, None, policy)
        else:
            self._refuse(404, "no such page")

    def do_POST(self) -> None:
        body = self._body()
        if body is None or not self._is_addressed():
            return
        if not self.page.access.is_own_origin(self.headers.get("Origin", ""), self.headers["Host"]):
            self._refuse(403, "requests from other pages are refused")
        elif self.path == "/command":
            self._command(body)
        elif self.path == READ_STREAM and self._may_watch():
            self._stream(body)
        else:
            self._refuse(403, "not permitted")

    def _body(self) -> bytes | None:
        """Read the body of a request; None if it is refused."""
        size = self.headers.get("Content-Length", "")
        if not size.isdecimal() or int(size) > MAX_REQUEST:
            self.close_connection = True
            self._refuse(413, f"the request must have a length of at most {MAX_REQUEST} bytes")
            return None
        return self.rfile.read(int(size))

    def _is_addressed(self) -> bool:
        """Whether the request names this page's own host; else it is refused."""
        if self.page.access.is_own_host(self.headers.get("Host", "")):
            return True
        self._refuse(421, "this page has another address")
        return False

    def _may_watch(self) -> bool:
        cookies = self.headers.get("Cookie", "")
        return self.page.access.may_watch(self.headers.get(TOKEN_HEADER, ""), cookies)

    def _may_control(self) -> bool:
        return self.page.access.may_control(self.headers.get(TOKEN_HEADER, ""))

    def _send_page(self, token: str) -> None:
        access = self.page.access
        if not access.may_watch(token, ""):
            self._refuse(403, "the token is missing or wrong: open the address that the terminal shows")
            return
        cookie = f"{access.cookie}={access.watch}; HttpOnly; SameSite=Strict; Path=/"
        more = {"Set-Cookie": cookie, "Content-Security-Policy": _PAGE_POLICY}
        self._send(200, "text/html; charset=utf-8", _file("page.html"), more)

    def _send_state(self) -> None:
        panel = self.page.panel
        state = {"controls": panel is not None and self._may_control()}
        self._send_json(200, state | (panel.state() if panel is not None else {}))

    def _command(self, body: bytes) -> None:
        if self.page.panel is None or not self._may_control():
            self._refuse(403, "only the address with the token to control may do this")
            return
        try:
            order = msgspec.json.decode(body, type=_Order)
        except (ValueError, RecursionError):
            self._send_json(400, {"error": 'a command is {"command": text, "value": text}'})
            return
        try:
            self._send_json(200, {"message": self.page.panel.perform(order.command, order.value)})
        except ValueError as error:
            self._send_json(400, {"error": str(error)})

    def _stream(self, body: bytes) -> None:
        if not self.page.free_places.acquire(blocking=False):
            self._refuse(503, "too many viewers")
            return
        try:
            forward(self, self.page.ports[1], READ_STREAM, body, _SAFE, self.page.note_viewer)
        finally:
            self.page.free_places.release()

    def _refuse(self, status: int, reason: str) -> None:
        self._send(status, "text/plain; charset=utf-8", f"{reason}\n".encode())

    def _send_json(self, status: int, content: dict[str, Any]) -> None:
        self._send(status, "application/json", json.dumps(content).encode())

    def _send(self, status: int, kind: str, content: bytes, more: dict[str, str] | None = None) -> None:
        self.send_response(status)
        for name, value in {**_SAFE, **(more or {})}.items():
            self.send_header(name, value)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)


@cache
def _file(name: str) -> bytes:
    return resources.files("deploy.dashboard").joinpath(name).read_bytes()
