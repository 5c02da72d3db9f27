"""Servers and clients of services: a request is a Zenoh query, the response is its reply.

The key has the name of the service, its type, and its hash. Request and response have the attachment of a message;
that of the response repeats number and gid of the request. A server may reply later: the result of an action can take
hours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import zenoh

from protocol.errors import ProtocolError
from protocol.ros2.attachments import Attachment, decode_attachment
from protocol.ros2.endpoints import Link, Receiver, content
from protocol.ros2.qos import DEFAULT
from protocol.ros2.tokens import Kind

TIMEOUT_S = 10.0
"""Time limit of a call."""
UNLIMITED_S = float(10 * 365 * 86400)


@dataclass
class Request:
    """A request: its message, its attachment, and the query that waits for the response."""

    message: Any
    source: Attachment
    _server: ServiceServer
    _query: zenoh.Query | None

    def reply(self, response: Any, now_ns: int) -> None:
        """Send the response, once, at `now_ns` since 1970; a second one raises ValueError."""
        if self._query is None:
            raise ValueError(f"{self._server.name}: this request has its response already")
        payload = self._server.link.messages.encode(response)
        attachment = Attachment(self.source.sequence, now_ns, self.source.gid)
        query, self._query = self._query, None
        query.reply(self._server.key, payload, attachment=attachment.encode())
        query.drop()  # type: ignore[no-untyped-call]


OnRequest = Callable[[Request, int], None]
"""Receives a request, and the time of `Ros2Node.spin`."""
OnResponse = Callable[[Any, int], None]
"""Receives the response, or None if there is none, and the time of `Ros2Node.spin`."""


class ServiceServer(Receiver):
    """A server of a service."""

    def __init__(self, link: Link, name: str, type_name: str, on_request: OnRequest) -> None:
        super().__init__(link, link.token(Kind.SERVER, name, type_name, DEFAULT), DEFAULT.kept, on_request)
        self._type = type_name
        self.announce(link.session.declare_queryable(self.key, self.put, complete=True))

    def decode(self, item: zenoh.Query) -> Request:
        """Decode a request; a malformed one gets no response."""
        try:
            source = decode_attachment(content(item.attachment))
            message = self.link.messages.decode(content(item.payload) or b"", f"{self._type}_Request")
        except ProtocolError:
            item.drop()  # type: ignore[no-untyped-call]
            raise
        return Request(message, source, self, item)


class ServiceClient(Receiver):
    """A client of a service."""

    def __init__(self, link: Link, name: str, type_name: str, timeout_s: float = TIMEOUT_S) -> None:
        super().__init__(link, link.token(Kind.CLIENT, name, type_name, DEFAULT), None, self._respond)
        self._type = type_name
        self._sequence = 0
        self._waiting: dict[int, OnResponse] = {}
        self._querier = link.session.declare_querier(
            self.key,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout_s,
        )
        self.announce(self._querier)

    @property
    def is_available(self) -> bool:
        """Whether a server is known."""
        return bool(self._querier.matching_status.matching)  # type: ignore[attr-defined]  # the stub says bool

    def call(self, request: Any, now_ns: int, on_response: OnResponse) -> None:
        """Send a request, at `now_ns` since 1970; `Ros2Node.spin` calls `on_response` once, with None for none."""
        payload = self.link.messages.encode(request)
        self._sequence += 1
        sequence = self._sequence
        self._waiting[sequence] = on_response
        arrive: zenoh.handlers.Callback[zenoh.Reply] = zenoh.handlers.Callback(
            lambda reply: self.put((sequence, reply)), lambda: self.put((sequence, None))
        )
        self._querier.get(arrive, payload=payload, attachment=Attachment(sequence, now_ns, self.gid).encode())

    def decode(self, item: tuple[int, zenoh.Reply | None]) -> tuple[int, Any]:
        """Decode a reply, None if there is none, to the response to a request; ProtocolError also for an error."""
        sequence, reply = item
        if reply is None:
            return sequence, None
        sample = reply.ok
        if sample is None:
            failure = reply.err
            text = failure.payload.to_bytes()[:200].decode(errors="replace") if failure else "no reply"
            raise ProtocolError(f"{self._type}_Response", 0, f"the server replied with an error: {text}")
        source = decode_attachment(content(sample.attachment))
        if source.sequence != sequence:
            reason = f"number {source.sequence} instead of {sequence}"
            raise ProtocolError(f"{self._type}_Response", 0, reason)
        return sequence, self.link.messages.decode(sample.payload.to_bytes(), f"{self._type}_Response")

    def _respond(self, decoded: tuple[int, Any], now_ns: int) -> None:
        """Hand a response to the callback of its request."""
        sequence, response = decoded
        on_response = self._waiting.pop(sequence, None)
        if on_response is not None:
            on_response(response, now_ns)
