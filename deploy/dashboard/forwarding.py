"""Forwarding of a page's requests to Rerun's own servers, which listen on the loopback and check nothing themselves.

Only reading is forwarded: the files of the web viewer, and the stream of a recording. Rerun's server would also let its
clients write.
"""

from __future__ import annotations

import http.client
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler

from deploy.dashboard.access import LOOPBACK

READ_STREAM = "/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"
"""The method of Rerun's server that sends a recording (gRPC-Web)."""
MAX_REQUEST = 4096
"""Maximum bytes of a request's body."""
PIECE = 1 << 16
STARTS_WITHIN_S = 20.0
"""Time in which a server must accept a connection: between a run and its recording there is none for a moment."""
_PASSED_ON = ("content-type", "rerun-final-length", "content-length", "grpc-status", "grpc-message")
_SENT_ON = ("Content-Type", "Accept", "X-Grpc-Web", "X-User-Agent", "Grpc-Timeout")


def forward(
    request: BaseHTTPRequestHandler,
    port: int,
    path: str,
    body: bytes | None,
    headers: dict[str, str],
    started: Callable[[], object] = lambda: None,
) -> None:
    """Answer a request with the answer of the server at `port`; `headers` are added.

    `started` is called once the answer has begun. A server that cannot be reached is answered with status 503.
    """
    sent = {name: request.headers[name] for name in _SENT_ON if name in request.headers}
    upstream = _connect(port)
    if upstream is None:
        request.send_error(503)
        return
    try:
        upstream.request("GET" if body is None else "POST", path, body, sent)
        answer = upstream.getresponse()
        request.send_response(answer.status)
        passed = {name: value for name, value in answer.getheaders() if name.lower() in _PASSED_ON}
        chunked = answer.length is None
        more = {"Transfer-Encoding": "chunked"} if chunked else {}
        for name, value in {**passed, **headers, **more}.items():
            request.send_header(name, value)
        request.end_headers()
        started()
        while piece := answer.read1(PIECE):
            request.wfile.write(b"%x\r\n%s\r\n" % (len(piece), piece) if chunked else piece)
            request.wfile.flush()
        if chunked:
            request.wfile.write(b"0\r\n\r\n")
    except (OSError, http.client.HTTPException):
        request.close_connection = True  # one of both ends has gone
    finally:
        upstream.close()


def _connect(port: int) -> http.client.HTTPConnection | None:
    until = time.monotonic() + STARTS_WITHIN_S
    while True:
        upstream = http.client.HTTPConnection(LOOPBACK, port)
        try:
            upstream.connect()
        except OSError:
            if time.monotonic() > until:
                return None
            time.sleep(0.1)
        else:
            return upstream
