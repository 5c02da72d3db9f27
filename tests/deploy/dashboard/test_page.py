"""The page of a run: its buttons control the run; requests without a token, or from elsewhere, have no effect."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

import pytest

from deploy.dashboard.access import Access, local_network_address
from deploy.dashboard.forwarding import READ_STREAM
from deploy.dashboard.page import Page
from deploy.run.control import Control
from deploy.run.exploration import explore
from deploy.run.live_commands import LiveCommands
from deploy.scenario.plan import make
from deploy.scenario.scenario import parse

WRITE_STREAM = READ_STREAM.replace("ReadMessages", "WriteMessages")


class Upstream(BaseHTTPRequestHandler):
    """A server in the place of Rerun's: it answers all requests, also those that must not reach it."""

    protocol_version = "HTTP/1.1"

    def log_message(self, *_: object) -> None:
        pass

    def do_GET(self) -> None:
        self._answer(f"file {self.path}".encode())

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self._answer(b"data for " + body)

    def _answer(self, content: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.send_header("Set-Cookie", "theirs=1")
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        for piece in (content[:4], content[4:]):
            self.wfile.write(b"%x\r\n%s\r\n" % (len(piece), piece))
        self.wfile.write(b"0\r\n\r\n")


class Visitor:
    """A browser without a screen: it sends what a page tells it to, and keeps nothing."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.host = urlsplit(page.url(controls=True)).netloc

    def ask(
        self, method: str, path: str, body: str | None = None, **headers: str
    ) -> tuple[int, str, dict[str, str]]:
        connection = http.client.HTTPConnection(self.host, timeout=20)
        named = {"Host": self.host} | {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, path, body, named)
        answer = connection.getresponse()
        content = answer.read().decode()
        connection.close()
        return answer.status, content, dict(answer.getheaders())

    def command(self, command: str, value: str = "", **headers: str) -> tuple[int, dict[str, str]]:
        own = {"Origin": f"http://{self.host}", "X_Murmur_Token": self.page.access.control}
        body = json.dumps({"command": command, "value": value})
        status, content, _ = self.ask("POST", "/command", body, **(own | headers))
        return status, json.loads(content) if content.startswith("{") else {"error": content}

    @property
    def cookie(self) -> str:
        access = self.page.access
        return f"{access.cookie}={access.watch}"


@pytest.fixture(scope="module")
def upstream() -> Iterator[int]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Upstream)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server.server_port
    server.shutdown()


@pytest.fixture
def control() -> Control:
    made = Control()
    made.attach(make(parse({"map": "em", "robots": 2})))
    return made


@pytest.fixture
def visitor(upstream: int, control: Control) -> Iterator[Visitor]:
    page = Page(Access(), (upstream, upstream), LiveCommands(control))
    yield Visitor(page)
    page.close()


def test_the_page_needs_the_token_of_its_address(visitor: Visitor) -> None:
    for token in (visitor.page.access.control, visitor.page.access.watch):
        status, content, headers = visitor.ask("GET", f"/?token={token}")
        assert (status, "Set bandwidth" in content) == (200, True)
        assert headers["Set-Cookie"].startswith(visitor.cookie)
        assert "HttpOnly; SameSite=Strict" in headers["Set-Cookie"]
        assert visitor.page.access.control not in content + str(headers)
    for path in ("/", "/?token=guess", "/?token=", "/?token=%C3%A4"):
        status, content, headers = visitor.ask("GET", path)
        assert status == 403
        assert "Set-Cookie" not in headers
        assert "open the address that the terminal shows" in content


@pytest.mark.parametrize("path", ["/state", "/page.js", "/viewer/", "/viewer/re_viewer.js"])
def test_everything_else_needs_the_token_too(path: str, visitor: Visitor) -> None:
    assert visitor.ask("GET", path)[0] == 403
    assert visitor.ask("GET", path, Cookie="murmur-=;;;\x7f")[0] == 403
    assert visitor.ask("GET", path, Cookie=visitor.cookie.replace("=", "=x"))[0] == 403
    assert visitor.ask("GET", path, Cookie=visitor.cookie)[0] == 200


def test_commands_control_the_run(visitor: Visitor, control: Control) -> None:
    assert visitor.command("pause") == (200, {"message": "paused"})
    assert control.paused
    visitor.command("step")
    assert control._credit.value == 1
    visitor.command("resume")
    assert not control.paused
    assert visitor.command("slower") == (200, {"message": "50 steps/s"})
    assert visitor.command("kill", "1") == (200, {"message": "robot 1 will be killed at the next step"})
    assert visitor.command("bandwidth", "500")[1] == {"message": "bandwidth 500 B from the next step"}
    assert visitor.command("range", " 25% ")[1] == {"message": "range 25% from the next step"}
    assert control._requests.qsize() == 3
    state = json.loads(visitor.ask("GET", "/state", X_Murmur_Token=visitor.page.access.control)[1])
    assert state == {
        "controls": True, "step": 0, "paused": False, "speed": 50.0, "robots": 2, "ended": False,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("command", "value", "message"),
    [
        ("kill", "7", "kill: unknown robot 7; the last one is 1"),
        ("kill", "", "kill: '' is not a robot number"),
        ("bandwidth", "much", "must be a whole number"),
        ("range", "-5", "range"),
        ("shutdown", "", "command = 'shutdown': must be one of pause, resume"),
    ],
)
def test_an_invalid_command_is_explained(command: str, value: str, message: str, visitor: Visitor) -> None:
    status, answer = visitor.command(command, value)
    assert status == 400
    assert message in answer["error"]


@pytest.mark.parametrize(
    "headers",
    [
        {"X_Murmur_Token": ""},
        {"X_Murmur_Token": "watch"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": ""},
        {"Host": "evil.example", "Origin": "http://evil.example"},
        {"Host": "127.0.0.1.evil.example", "Origin": "http://127.0.0.1.evil.example"},
        {"Host": "[", "Origin": "http://["},
    ],
    ids=str,
)
def test_commands_without_the_token_or_from_elsewhere_have_no_effect(
    headers: dict[str, str], visitor: Visitor, control: Control
) -> None:
    token = visitor.page.access.watch
    sent = {name: token if value == "watch" else value for name, value in headers.items()}
    status, _ = visitor.command("pause", **sent, Cookie=visitor.cookie)
    assert status in (403, 421)
    assert not control.paused


@pytest.mark.parametrize("body", ["", "[]", '{"command": 1}', '{"value": "x"}', "[" * 2000, "\xff"], ids=len)
def test_malformed_commands_are_refused(body: str, visitor: Visitor) -> None:
    own = {"Origin": f"http://{visitor.host}", "X_Murmur_Token": visitor.page.access.control}
    assert visitor.ask("POST", "/command", body, **own)[0] == 400
    assert visitor.ask("POST", "/command", "x" * 5000, **own)[0] == 413


def test_another_host_name_is_refused_and_a_forwarded_port_is_not(visitor: Visitor) -> None:
    path = f"/?token={visitor.page.access.watch}"
    assert visitor.ask("GET", path, Host="evil.example")[0] == 421
    assert visitor.ask("GET", path, Host="localhost:8080")[0] == 200
    assert visitor.ask("GET", path, Host="127.0.0.1:9")[0] == 200
    shared = Access("192.168.7.7")
    assert shared.is_own_host("192.168.7.7:5000")
    assert not shared.is_own_host("localhost:5000")


def test_viewers_can_read_the_stream_and_not_write(visitor: Visitor) -> None:
    own = {"Origin": f"http://{visitor.host}", "Cookie": visitor.cookie}
    status, content, headers = visitor.ask("POST", READ_STREAM, "me", **own)
    assert (status, content) == (200, "data for me")
    assert "Set-Cookie" not in headers
    assert visitor.ask("POST", READ_STREAM, "me", Origin=own["Origin"])[0] == 403
    assert visitor.ask("POST", WRITE_STREAM, "me", **own)[0] == 403
    assert visitor.ask("PUT", READ_STREAM, "me", **own)[0] == 501
    status, content, headers = visitor.ask("GET", "/viewer/a.js?b=c", Cookie=visitor.cookie)
    assert (status, content) == (200, "file /a.js")
    assert "connect-src 'self'" in headers["Content-Security-Policy"]


def test_the_first_viewer_is_announced_once(upstream: int) -> None:
    seen: list[int] = []
    page = Page(Access(), (upstream, upstream), None, lambda: seen.append(1))
    try:
        visitor = Visitor(page)
        own = {"Origin": f"http://{visitor.host}", "Cookie": visitor.cookie}
        visitor.ask("GET", "/viewer/", Cookie=visitor.cookie)
        assert seen == []
        for _ in range(2):
            visitor.ask("POST", READ_STREAM, "me", **own)
        assert seen == [1]
    finally:
        page.close()


def test_a_page_without_a_run_has_no_commands(upstream: int) -> None:
    page = Page(Access(), (upstream, upstream))
    try:
        visitor = Visitor(page)
        assert visitor.command("pause")[0] == 403
        state = visitor.ask("GET", "/state", X_Murmur_Token=page.access.control)[1]
        assert json.loads(state) == {"controls": False}
    finally:
        page.close()


def test_commands_of_the_page_are_recorded_so_that_the_run_repeats(upstream: int) -> None:
    settings = {"map": "em", "robots": 3, "range": "30%", "bandwidth": 600, "steps": 40, "bus": "memory"}
    control, sent = Control(), []
    commands = LiveCommands(control)
    page = Page(Access(), (upstream, upstream), commands)
    visitor = Visitor(page)

    def watch(_: object, records: Any) -> None:
        if records.step == 10:
            sent.extend([visitor.command("bandwidth", "100"), visitor.command("kill", "1")])

    try:
        result = explore(parse(settings), keep=False, control=control, watch=watch)
        commands.has_ended = True
        assert visitor.command("kill", "2") == (400, {"error": "the run is over"})
    finally:
        page.close()
    assert [status for status, _ in sent] == [200, 200]
    scenario = result.plan.scenario
    assert [each.bandwidth for each in scenario.change] == [100]
    assert [each.robot for each in scenario.fault] == [1]
    assert control.step_now == result.summary["steps"]
    again = explore(parse(scenario.model_dump()), keep=False)
    assert again.summary["digest"] == result.summary["digest"]


def test_a_public_address_is_not_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    def address(found: str) -> None:
        class Probe:
            def __init__(self, *_: object) -> None: ...
            def __enter__(self) -> Probe:
                return self

            def __exit__(self, *_: object) -> None: ...
            def connect(self, _: object) -> None: ...
            def getsockname(self) -> tuple[str, int]:
                return found, 1

        monkeypatch.setattr("socket.socket", Probe)

    address("192.168.1.20")
    assert local_network_address() == "192.168.1.20"
    for found in ("8.8.4.4", "127.0.0.1"):
        address(found)
        with pytest.raises(ValueError, match="is not an address of a local network"):
            local_network_address()
