"""Interoperability with two independent implementations of rmw_zenoh's protocol: zenoh-ros2-sdk and pyzeros.

Both use a router of ours on loopback. zenoh-ros2-sdk connects as ROS 2 does, as a peer. Its types come from rosbags,
those of pyzeros from another implementation of CDR and type hashes.
"""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable, Coroutine, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given

from protocol.ros2 import messages as names
from protocol.ros2.attachments import Attachment, decode_attachment
from protocol.ros2.interfaces import fields_of, service
from protocol.ros2.messages import Messages
from protocol.ros2.node import Ros2Node
from protocol.ros2.qos import DEFAULT, LATCHED, SENSOR, Qos
from protocol.ros2.services import Request
from protocol.ros2.session import open_client
from protocol.ros2.tokens import EndpointToken, Kind, NodeToken, gid
from tests.protocol.ros2.peer_messages import NOW_NS, plain, sample
from tests.protocol.ros2.test_attachments import attachments
from tests.protocol.ros2.test_tokens import endpoints
from tests.protocol.ros2.waiting import LIMIT_S, spin_until

# What pyzeros compiles belongs to the environment, not into the working directory.
os.environ.setdefault("CYDR_CACHE_DIR", str(Path(sys.prefix) / "cache" / "cydr"))

sdk = pytest.importorskip("zenoh_ros2_sdk")
pyzeros = pytest.importorskip("pyzeros")

from pyzeros.builtin_msgs import Attachment as PyzerosAttachment  # noqa: E402
from pyzeros.pub import token_keyexpr as pyzeros_token  # noqa: E402
from pyzeros.qos import QosProfile as PyzerosQos  # noqa: E402
from pyzeros.utils import rmw_zenoh_gid  # noqa: E402
from ros2_pyterfaces.cyclone import all_srvs  # noqa: E402
from zenoh_ros2_sdk.attachment import Attachment as SdkAttachment  # noqa: E402
from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity  # noqa: E402
from zenoh_ros2_sdk.keyexpr import endpoint_liveliness_keyexpr, node_liveliness_keyexpr  # noqa: E402
from zenoh_ros2_sdk.session import ZenohSession  # noqa: E402

from tests.protocol.ros2.pyzeros_types import pyzeros_type, to_pyzeros  # noqa: E402

OpenNode = Callable[..., Ros2Node]
Received = list[tuple[Any, Attachment]]

TOPICS = {
    names.LASER_SCAN: SENSOR,
    names.TRANSFORMS: DEFAULT,
    names.POSE_STAMPED: DEFAULT,
    names.OCCUPANCY_GRID: LATCHED,
    names.ODOMETRY: DEFAULT,
    names.TWIST: DEFAULT,
    names.CLOCK: DEFAULT,
    names.STRING: DEFAULT,
    names.MARKERS: DEFAULT,
}
"""Types, each with the quality of service of its usual topic."""
SET_BOOL = "std_srvs/srv/SetBool"
REQUEST, RESPONSE = "bool data", "bool success\nstring message"


def collect(into: Received) -> Callable[[Any, Attachment], None]:
    return lambda message, source: into.append((message, source))


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    """Let pyzeros compile its attachments, which it does once per environment, in some 10 s."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-O0")
        try:
            PyzerosAttachment().serialize()
        except Exception as error:  # Cython and setuptools raise errors of many types
            pytest.skip(f"pyzeros cannot compile its messages: {error}")


@pytest.fixture(scope="module")
def sdk_session(router: str) -> Iterator[Any]:
    """Open the one session of zenoh-ros2-sdk with the types of rosbags: it would load them from the internet."""
    host, _, port = router.removeprefix("tcp/").rpartition(":")
    session = ZenohSession(host, int(port))
    session.store = Messages("jazzy").types
    session._registered_types = {name: name for name in session.store.types}
    ZenohSession._instance = session
    yield session
    ZenohSession._instance = None
    session.session.close()


def in_pyzeros(router: str, work: Callable[[Any], Coroutine[Any, Any, None]]) -> None:
    """Run a coroutine with a node of pyzeros."""

    async def run() -> None:
        with open_client(router) as session, pyzeros.auto_context("peer", session, namespace="/r1") as peer:
            await asyncio.wait_for(work(peer), LIMIT_S)

    asyncio.run(run())


@pytest.mark.parametrize("name", TOPICS)
def test_pyzeros_computes_the_same_type_hash(name: str) -> None:
    assert pyzeros_type(name).hash_rihs01() == Messages("jazzy").type_hash(name)


@pytest.mark.parametrize("name", TOPICS)
def test_pyzeros_receives_exact_values(node: OpenNode, router: str, name: str) -> None:
    murmur = node("murmur", "r1")
    message = sample(murmur.messages, name)

    async def receive(peer: Any) -> None:
        received: asyncio.Queue[Any] = asyncio.Queue()
        subscription = pyzeros.Sub(pyzeros_type(name), "topic", session=peer)
        subscription.asap_callback.append(received.put_nowait)
        publisher = murmur.publisher("topic", name, TOPICS[name])
        while received.empty():
            publisher.publish(message, NOW_NS)
            await asyncio.sleep(0.01)
        assert plain(received.get_nowait()) == plain(message)
        subscription.close()

    in_pyzeros(router, receive)


@pytest.mark.parametrize("name", TOPICS)
def test_pyzeros_sends_exact_values(node: OpenNode, router: str, name: str) -> None:
    murmur = node("murmur", "r1")
    message = sample(murmur.messages, name)
    received: Received = []
    murmur.subscription("topic", name, TOPICS[name], collect(received))

    async def send(peer: Any) -> None:
        publisher = pyzeros.Pub(pyzeros_type(name), "topic", session=peer)
        spin_until(lambda: publisher.zenoh_pub.matching_status.matching)
        publisher.publish(to_pyzeros(pyzeros_type(name), message))
        spin_until(lambda: received, murmur)
        assert received[0][1].gid == gid(publisher.token_keyexpr)
        publisher.close()

    in_pyzeros(router, send)
    assert plain(received[0][0]) == plain(message)
    assert murmur.rejected == {}


@pytest.mark.parametrize("name", TOPICS)
def test_zenoh_ros2_sdk_receives_exact_values(node: OpenNode, sdk_session: Any, name: str) -> None:
    murmur = node("murmur", "r1")
    message = sample(murmur.messages, name)
    publisher = murmur.publisher("topic", name, TOPICS[name])
    received: list[Any] = []
    peer = sdk.ROS2Subscriber(
        "/r1/topic", name, received.append, msg_definition="", type_hash=murmur.messages.type_hash(name)
    )
    spin_until(lambda: publisher.publish(message, NOW_NS) or received)
    peer.close()
    assert plain(received[0]) == plain(message)


@pytest.mark.parametrize("name", TOPICS)
def test_zenoh_ros2_sdk_sends_exact_values(node: OpenNode, sdk_session: Any, name: str) -> None:
    murmur = node("murmur", "r1")
    message = sample(murmur.messages, name)
    received: Received = []
    murmur.subscription("topic", name, TOPICS[name], collect(received))
    peer = sdk.ROS2Publisher("/r1/topic", name, msg_definition="", type_hash=murmur.messages.type_hash(name))
    spin_until(lambda: peer.pub.matching_status.matching)
    peer.publish(**{each.name: getattr(message, each.name) for each in fields(message) if each.init})
    spin_until(lambda: received, murmur)
    assert received[0][1].gid == peer.publisher_gid
    peer.close()
    assert plain(received[0][0]) == plain(message)


def test_zenoh_ros2_sdk_that_joins_late_receives_the_last_map(node: OpenNode, sdk_session: Any) -> None:
    murmur = node("murmur", "r1")
    publisher = murmur.publisher("/team_map", names.OCCUPANCY_GRID, LATCHED)
    message = sample(murmur.messages, names.OCCUPANCY_GRID)
    for value in (3, 100):
        message.data[1] = value
        publisher.publish(message, NOW_NS)
    spin_until(lambda: "/team_map" in murmur.graph().topics)
    received: list[Any] = []
    peer = sdk.ROS2Subscriber(
        "/team_map",  # it does not find publishers of topics in a namespace
        names.OCCUPANCY_GRID,
        received.append,
        msg_definition="",
        type_hash=murmur.messages.type_hash(names.OCCUPANCY_GRID),
        qos=str(LATCHED),
    )
    spin_until(lambda: received)
    peer.close()
    assert [plain(each) for each in received] == [plain(message)]


def test_the_endpoints_of_both_peers_are_in_the_graph(node: OpenNode, router: str, sdk_session: Any) -> None:
    murmur = node("murmur", "r1")
    scan = murmur.messages.type_hash(names.LASER_SCAN)
    peer = sdk.ROS2Publisher(
        "/r2/scan", names.LASER_SCAN, msg_definition="", type_hash=scan, node_name="lidar", namespace="/r2"
    )

    async def look(other: Any) -> None:
        subscription = pyzeros.Sub(pyzeros_type(names.LASER_SCAN), "scan", session=other)
        spin_until(lambda: len(murmur.graph().topics) == 2 and len(murmur.graph().nodes) == 3)
        graph = murmur.graph()
        assert {each.full_name for each in graph.nodes} == {"/r1/murmur", "/r1/peer", "/r2/lidar"}
        assert graph.topics == {"/r1/scan": [names.LASER_SCAN], "/r2/scan": [names.LASER_SCAN]}
        subscription.close()

    in_pyzeros(router, look)
    peer.close()


@given(endpoints())
def test_tokens_and_gids_of_both_peers_are_the_same(token: EndpointToken) -> None:
    where, key, qos = token.node, token.data_key, token.qos
    simple = Qos(qos.reliability, qos.durability, depth=7)
    where = NodeToken(where.domain, where.session, where.node_id, where.namespace, where.name)
    ours = EndpointToken(where, token.entity_id, Kind.PUBLISHER, key, simple)
    theirs = pyzeros_token(
        name=key.name,
        dds_type=str(key).split("/")[-2],
        hash=key.type_hash,
        qos_profile=PyzerosQos(depth=7, reliability=int(qos.reliability), durability=int(qos.durability)),
        node_name=where.name,
        session=object(),
        domain_id=where.domain,
        namespace=where.namespace,
        _zenoh_id=where.session,
        _node_id=where.node_id,
        _entity_id=token.entity_id,
    )
    assert str(ours) == theirs
    assert gid(str(ours)) == rmw_zenoh_gid(theirs)

    entity = NodeEntity(where.domain, where.session, where.node_id, where.name, where.namespace)
    endpoint = EndpointEntity(
        entity,
        token.entity_id,
        EntityKind(str(token.kind)),
        key.name,
        str(key).split("/")[-2],
        key.type_hash,
        str(qos),
    )
    assert node_liveliness_keyexpr(entity) == str(where)
    assert endpoint_liveliness_keyexpr(endpoint) == str(
        EndpointToken(where, token.entity_id, token.kind, key, qos)
    )


@given(attachments)
def test_attachments_of_both_peers_are_the_same(attachment: Attachment) -> None:
    theirs = PyzerosAttachment(
        sequence_number=attachment.sequence,
        source_timestamp=attachment.stamp_ns,
        source_gid=np.frombuffer(attachment.gid, np.uint8),
    )
    assert attachment.encode() == bytes(theirs.serialize())[4:]
    other = SdkAttachment(attachment.sequence, attachment.stamp_ns, attachment.gid)
    assert attachment.encode() == other.to_bytes()
    assert decode_attachment(other.to_bytes()) == attachment


def set_bool_node(node: OpenNode) -> Ros2Node:
    """Return a node that knows a service that both peers know."""
    murmur = node("murmur", "r1")
    murmur.messages.register(service(SET_BOOL, fields_of(REQUEST)[1], fields_of(RESPONSE)[1]))
    return murmur


def echo(murmur: Ros2Node) -> Callable[[Request, int], None]:
    """Return a handler that answers with what it has received."""

    def answer(request: Request, now_ns: int) -> None:
        response = murmur.messages[f"{SET_BOOL}_Response"](success=request.message.data, message="done")
        request.reply(response, now_ns)

    return answer


def call(murmur: Ros2Node, then: Callable[[], object] = lambda: None) -> Any:
    """Call the service as a client; return the response."""
    client = murmur.client("stop", SET_BOOL)
    spin_until(lambda: client.is_available)
    responses: list[Any] = []
    client.call(
        murmur.messages[f"{SET_BOOL}_Request"](data=True), NOW_NS, lambda each, _: responses.append(each)
    )
    then()
    return responses


def test_a_service_hash_is_the_same_in_pyzeros(node: OpenNode) -> None:
    assert set_bool_node(node).messages.type_hash(SET_BOOL) == all_srvs.SetBool.hash_rihs01()


def test_pyzeros_calls_a_service(node: OpenNode, router: str) -> None:
    murmur = set_bool_node(node)
    murmur.server("stop", SET_BOOL, echo(murmur))

    async def request(peer: Any) -> None:
        client = pyzeros.Client(all_srvs.SetBool, "stop", session=peer)
        await client.wait_for_service()
        waiting = asyncio.ensure_future(client.call_async(all_srvs.SetBool.Request(data=True)))
        while not waiting.done():
            murmur.spin(NOW_NS, 0.0)
            await asyncio.sleep(0.005)
        response = waiting.result()
        assert (response.success, response.message) == (True, "done")
        client.close()

    in_pyzeros(router, request)


def test_pyzeros_answers_a_call(node: OpenNode, router: str) -> None:
    murmur = set_bool_node(node)

    async def serve(peer: Any) -> None:
        server = pyzeros.Server(all_srvs.SetBool, "stop", session=peer)
        responses = call(murmur)
        async for each in server.listen_reliable():
            each.response.success, each.response.message = each.request.data, "done"
            each.send()
            break
        spin_until(lambda: responses, murmur)
        assert (responses[0].success, responses[0].message) == (True, "done")
        server.close()

    in_pyzeros(router, serve)


def sdk_service(murmur: Ros2Node) -> dict[str, Any]:
    """Return the definitions that zenoh-ros2-sdk needs."""
    return {
        "request_definition": REQUEST,
        "response_definition": RESPONSE,
        "type_hash": murmur.messages.type_hash(SET_BOOL),
    }


def test_zenoh_ros2_sdk_calls_a_service(node: OpenNode, sdk_session: Any) -> None:
    murmur = set_bool_node(node)
    murmur.server("stop", SET_BOOL, echo(murmur))
    client = sdk.ROS2ServiceClient("/r1/stop", SET_BOOL, **sdk_service(murmur))
    spin_until(lambda: client.querier.matching_status.matching)
    responses: list[Any] = []
    client.call_async(responses.append, data=True)
    spin_until(lambda: responses, murmur, now_ns=NOW_NS)
    client.close()
    assert (responses[0].success, responses[0].message) == (True, "done")


def test_zenoh_ros2_sdk_answers_a_call(node: OpenNode, sdk_session: Any) -> None:
    murmur = set_bool_node(node)

    def answer(request: Any) -> Any:
        kind = sdk_session.store.types[sdk_session._registered_types[f"{SET_BOOL}_Response"]]
        return kind(success=request.data, message="done")

    server = sdk.ROS2ServiceServer("/r1/stop", SET_BOOL, answer, **sdk_service(murmur))
    responses = call(murmur)
    spin_until(lambda: responses, murmur)
    server.close()
    assert (responses[0].success, responses[0].message) == (True, "done")
