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
from protocol.ros2.qos import Qos
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

    def __init__(self, link: Link, name: str, type_name: str, qos: Qos, on_request: OnRequest) -> None:
        super().__init__(link, link.token(Kind.SERVER, name, type_name, qos), qos.kept)
        self._type = type_name
        self._on_request = on_request
        self.announce(link.session.declare_queryable(self.key, self.put, complete=True))

    def take(self, now_ns: int) -> int:
        """Decode all requests of the inbox and hand them to the callback; return how many."""
        taken = len(self.inbox)
        for _ in range(taken):
            query = self.inbox.popleft()
            try:
                source = decode_attachment(content(query.attachment))
                message = self.link.messages.decode(content(query.payload) or b"", f"{self._type}_Request")
            except ProtocolError as error:
                self.reject(error)
                query.drop()
                continue
            self._on_request(Request(message, source, self, query), now_ns)
        return taken


class ServiceClient(Receiver):
    """A client of a service."""

    def __init__(self, link: Link, name: str, type_name: str, qos: Qos, timeout_s: float = TIMEOUT_S) -> None:
        super().__init__(link, link.token(Kind.CLIENT, name, type_name, qos), None)
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
        self._querier.get(
            arrive,
            payload=payload,
            attachment=Attachment(sequence, now_ns, self.gid).encode(),
        )

    def take(self, now_ns: int) -> int:
        """Hand the responses of the inbox to their callbacks; return how many items the inbox had."""
        taken = len(self.inbox)
        for _ in range(taken):
            sequence, reply = self.inbox.popleft()
            response = None
            if reply is not None:
                try:
                    response = self._response(sequence, reply)
                except ProtocolError as error:
                    self.reject(error)
                    continue
            on_response = self._waiting.pop(sequence, None)
            if on_response is not None:
                on_response(response, now_ns)
        return taken

    def _response(self, sequence: int, reply: zenoh.Reply) -> Any:
        """Decode a reply; ProtocolError if it is an error, or malformed."""
        sample = reply.ok
        if sample is None:
            failure = reply.err
            text = failure.payload.to_bytes()[:200].decode(errors="replace") if failure else "no reply"
            raise ProtocolError(f"{self._type}_Response", 0, f"the server replied with an error: {text}")
        source = decode_attachment(content(sample.attachment))
        if source.sequence != sequence:
            reason = f"number {source.sequence} instead of {sequence}"
            raise ProtocolError(f"{self._type}_Response", 0, reason)
        return self.link.messages.decode(sample.payload.to_bytes(), f"{self._type}_Response")
