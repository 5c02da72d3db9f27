"""A node that ROS 2 nodes with rmw_zenoh see as one of theirs."""

from __future__ import annotations

from typing import Self, TypeVar

from protocol.ros2.actions import ActionClient, ActionServer, OnCancel, OnGoal
from protocol.ros2.endpoints import Endpoint, Link, Receiver
from protocol.ros2.graph import Graph, read_domains, read_graph
from protocol.ros2.messages import Messages
from protocol.ros2.names import check_domain, check_node
from protocol.ros2.qos import DEFAULT, Qos
from protocol.ros2.services import OnRequest, ServiceClient, ServiceServer
from protocol.ros2.session import ROUTER, open_client
from protocol.ros2.tokens import NodeToken
from protocol.ros2.topics import OnMessage, Publisher, Subscription

_Endpoint = TypeVar("_Endpoint", bound=Endpoint)


class Ros2Node:
    """A node with a Zenoh session of its own, a client of the router at `router`.

    Names of topics and services are relative to the node's namespace unless they begin with a slash. Types are names
    as ``std_msgs/msg/String``. The node reads no clock: times are nanoseconds since 1970, from the caller. Callbacks
    run in `spin`.

    Raises ValueError if a name, the domain, or the distribution is wrong; ConnectionError if no router answers.
    """

    def __init__(
        self, name: str, namespace: str = "/", domain: int = 0, *, distro: str = "jazzy", router: str = ROUTER
    ) -> None:
        namespace = check_node(name, namespace)
        self.messages = Messages(distro)
        check_domain(domain)
        self._session = open_client(router)
        token = NodeToken(domain, str(self._session.info.zid()), 0, namespace, name)
        self._link = Link(self._session, token, self.messages)
        self._endpoints: list[Endpoint] = []
        self._liveliness = self._session.liveliness().declare_token(str(token))

    @property
    def token(self) -> NodeToken:
        """The liveliness token of the node."""
        return self._link.node

    @property
    def is_connected(self) -> bool:
        """Whether the router answers; after it was lost, Zenoh connects again as soon as it is back."""
        info = self._session.info
        return bool(info.routers_zid() or info.peers_zid())

    def publisher(self, topic: str, type_name: str, qos: Qos = DEFAULT) -> Publisher:
        """Declare a publisher."""
        return self._added(Publisher(self._link, topic, type_name, qos))

    def subscription(self, topic: str, type_name: str, qos: Qos, on_message: OnMessage) -> Subscription:
        """Declare a subscription; `spin` hands each message, with its attachment, to `on_message`."""
        return self._added(Subscription(self._link, topic, type_name, qos, on_message))

    def server(self, name: str, type_name: str, on_request: OnRequest) -> ServiceServer:
        """Declare a server; `spin` hands each request to `on_request`, which replies now or later."""
        return self._added(ServiceServer(self._link, name, type_name, on_request))

    def client(self, name: str, type_name: str) -> ServiceClient:
        """Declare a client of a service."""
        return self._added(ServiceClient(self._link, name, type_name))

    def action_server(self, name: str, type_name: str, on_goal: OnGoal, on_cancel: OnCancel) -> ActionServer:
        """Declare a server of an action."""
        server = ActionServer(self._link, name, type_name, on_goal, on_cancel)
        self._endpoints += server.endpoints
        return server

    def action_client(self, name: str, type_name: str) -> ActionClient:
        """Declare a client of an action."""
        client = ActionClient(self._link, name, type_name)
        self._endpoints += client.endpoints
        return client

    def spin(self, now_ns: int, timeout_s: float = 0.0) -> int:
        """Wait until something arrives, at most `timeout_s`, and handle it; return the number of items handled.

        Endpoints take turns in the order of their declaration: declare transforms before the scans that need them.
        """
        self._link.wake.wait(timeout_s)
        self._link.wake.clear()
        return sum(each.take(now_ns) for each in self._receivers)

    @property
    def rejected(self) -> dict[str, str]:
        """The last malformed message of each topic and service that had one: name to error, with the number of them."""
        return {each.name: f"{each.rejected}: {each.last_error}" for each in self._receivers if each.rejected}

    @property
    def _receivers(self) -> list[Receiver]:
        return [each for each in self._endpoints if isinstance(each, Receiver)]

    def graph(self) -> Graph:
        """Return all nodes, topics, and services of the domain that are visible now."""
        return read_graph(self._session, self.token.domain)

    def domains(self) -> set[int]:
        """Return all domains in which nodes are visible now."""
        return read_domains(self._session)

    def close(self) -> None:
        """Withdraw all endpoints, then the node, and close its session."""
        while self._endpoints:
            self._endpoints.pop().close()
        if not self._session.is_closed():
            self._liveliness.undeclare()  # type: ignore[no-untyped-call]
            self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _added(self, endpoint: _Endpoint) -> _Endpoint:
        self._endpoints.append(endpoint)
        return endpoint
