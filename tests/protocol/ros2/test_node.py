"""Nodes that talk to each other over a router: topics, services, tokens, and what goes wrong."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import zenoh

from protocol.ros2 import messages as names
from protocol.ros2.attachments import Attachment
from protocol.ros2.graph import parse_graph
from protocol.ros2.interfaces import CANCEL_GOAL
from protocol.ros2.node import Ros2Node
from protocol.ros2.qos import DEFAULT, LATCHED, SENSOR, Qos
from protocol.ros2.services import Request, ServiceClient
from protocol.ros2.session import open_client, open_router
from protocol.ros2.tokens import Kind, gid
from protocol.ros2.topics import Publisher
from tests.protocol.ros2.waiting import spin_until

OpenNode = Callable[..., Ros2Node]
Received = list[tuple[Any, Attachment]]


def collect(into: Received) -> Callable[[Any, Attachment], None]:
    return lambda message, source: into.append((message, source))


def wait_for_subscription(publisher: Publisher) -> None:
    """Wait until the session of a volatile publisher knows a subscription."""
    spin_until(lambda: publisher._publisher.matching_status.matching)


def test_a_subscription_receives_messages_in_order_with_number_time_and_gid(node: OpenNode) -> None:
    sender, receiver = node("sender", "r1"), node("receiver", "/r1")
    received: Received = []
    receiver.subscription("chatter", names.STRING, DEFAULT, collect(received))
    publisher = sender.publisher("chatter", names.STRING)
    sent = [sender.messages[names.STRING](data=f"message {number}") for number in range(5)]
    wait_for_subscription(publisher)
    for number, each in enumerate(sent):
        publisher.publish(each, 1000 + number)
    spin_until(lambda: len(received) == 5, receiver)
    assert [message.data for message, _ in received] == [each.data for each in sent]
    expected = [Attachment(number + 1, 1000 + number, gid(str(publisher.token))) for number in range(5)]
    assert [source for _, source in received] == expected


def test_a_message_on_the_wire_has_key_cdr_and_attachment(node: OpenNode, router: str) -> None:
    sender = node("sender", "r1", 7)
    samples: list[tuple[str, bytes, bytes, str]] = []
    with open_client(router) as stranger:

        def arrive(sample: zenoh.Sample) -> None:
            assert sample.attachment is not None
            content = sample.payload.to_bytes(), sample.attachment.to_bytes()
            samples.append((str(sample.key_expr), *content, str(sample.encoding)))

        stranger.declare_subscriber("7/**", arrive)
        publisher = sender.publisher("chatter", names.STRING)
        wait_for_subscription(publisher)
        publisher.publish(sender.messages[names.STRING](data="a"), 0x1122334455667788)
        spin_until(lambda: samples)
    key = (
        "7/r1/chatter/std_msgs::msg::dds_::String_/"
        "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    )
    cdr = bytes.fromhex("00010000020000006100")
    attachment = bytes.fromhex("0100000000000000887766554433221110") + gid(str(publisher.token))
    assert samples == [(key, cdr, attachment, "zenoh/bytes")]


def test_a_late_subscription_receives_the_last_transient_local_message_only(node: OpenNode) -> None:
    mapper, viewer = node("mapper"), node("viewer")
    publisher = mapper.publisher("map", names.OCCUPANCY_GRID, LATCHED)
    for value in (0, 100):
        grid = mapper.messages.new(names.OCCUPANCY_GRID, data=np.full(12, value, np.int8))
        publisher.publish(grid, value)
    received: Received = []
    viewer.subscription("map", names.OCCUPANCY_GRID, LATCHED, collect(received))
    spin_until(lambda: received, viewer)
    assert [source.stamp_ns for _, source in received] == [100]
    np.testing.assert_array_equal(received[0][0].data, np.full(12, 100))


def test_a_slow_subscription_keeps_the_last_messages(node: OpenNode) -> None:
    sender, receiver = node("sender"), node("receiver")
    received: Received = []
    subscription = receiver.subscription("scan", names.STRING, Qos(depth=2), collect(received))
    publisher = sender.publisher("scan", names.STRING, SENSOR)
    wait_for_subscription(publisher)
    for number in range(6):
        publisher.publish(sender.messages[names.STRING](data=str(number)), number)
    spin_until(lambda: subscription.inbox and subscription.inbox[-1][1].startswith(b"\x06"))
    receiver.spin(0)
    assert [message.data for message, _ in received] == ["4", "5"]


def test_messages_stay_in_their_domain(node: OpenNode) -> None:
    sender, receiver = node("sender", "/", 1), node("receiver", "/", 2)
    received: Received = []
    receiver.subscription("chatter", names.STRING, DEFAULT, collect(received))
    fence: Received = []
    receiver.subscription("fence", names.STRING, DEFAULT, collect(fence))
    sender.publisher("chatter", names.STRING).publish(sender.messages[names.STRING](data="a"), 0)
    third = node("third", "/", 2).publisher("fence", names.STRING)
    wait_for_subscription(third)
    third.publish(sender.messages[names.STRING](data="b"), 0)
    spin_until(lambda: fence, receiver)
    assert received == []


@pytest.mark.parametrize(
    ("payload", "attachment", "reason"),
    [
        (b"\0\1\0\0\2\0\0\0a\0", None, "none instead of 33 bytes"),
        (b"\0\1\0\0\2\0\0\0a\0", bytes(20), "20 bytes instead of 33 bytes"),
        (b"", Attachment(1, 2, bytes(16)).encode(), "malformed CDR of 0 bytes"),
        (b"\0\1\0\0\xff\xff\xff\xff", Attachment(1, 2, bytes(16)).encode(), "malformed CDR of 8 bytes"),
    ],
)
def test_a_malformed_message_is_counted_and_the_next_one_received(
    node: OpenNode, router: str, payload: bytes, attachment: bytes | None, reason: str
) -> None:
    receiver = node("receiver")
    received: Received = []
    subscription = receiver.subscription("chatter", names.STRING, DEFAULT, collect(received))
    with open_client(router) as stranger:
        route = stranger.declare_publisher(subscription.key)
        spin_until(lambda: route.matching_status.matching)
        stranger.put(subscription.key, payload, attachment=attachment)
        stranger.put(
            subscription.key, b"\0\1\0\0\2\0\0\0a\0", attachment=Attachment(1, 2, bytes(16)).encode()
        )
        spin_until(lambda: received, receiver)
    assert [message.data for message, _ in received] == ["a"]
    assert subscription.rejected == 1
    assert reason in receiver.rejected["/chatter"]


def test_a_message_of_another_type_is_not_sent(node: OpenNode) -> None:
    sender = node("sender")
    publisher = sender.publisher("chatter", names.STRING)
    with pytest.raises(ValueError, match="/chatter has messages of type std_msgs/msg/String, not rosgraph"):
        publisher.publish(sender.messages.new(names.CLOCK), 0)


def test_tokens_appear_with_an_endpoint_and_vanish_with_it(node: OpenNode, router: str) -> None:
    murmur, watcher = node("murmur", "r1"), node("watcher")
    murmur.publisher("map", names.OCCUPANCY_GRID, LATCHED)
    murmur.subscription("scan", names.LASER_SCAN, SENSOR, lambda *_: None)
    murmur.server("cancel", CANCEL_GOAL, lambda *_: None)
    murmur.client("cancel", CANCEL_GOAL)
    spin_until(lambda: len(watcher.graph().endpoints) == 4)
    graph = watcher.graph()
    assert {each.full_name for each in graph.nodes} == {"/r1/murmur", "/watcher"}
    assert graph.topics == {
        "/r1/map": ["nav_msgs/msg/OccupancyGrid"],
        "/r1/scan": ["sensor_msgs/msg/LaserScan"],
    }
    assert graph.services == {"/r1/cancel": ["action_msgs/srv/CancelGoal"]}
    assert [str(each.qos) for each in graph.of_topic("/r1/map", Kind.PUBLISHER)] == [":1:,1:,:,:,,"]
    assert [str(each.qos) for each in graph.of_topic("/r1/scan", Kind.SUBSCRIPTION)] == ["2::,5:,:,:,,"]
    assert sorted(each.entity_id for each in graph.endpoints) == [1, 2, 3, 4]

    murmur.close()
    spin_until(lambda: [each.full_name for each in watcher.graph().nodes] == ["/watcher"])
    spin_until(lambda: watcher.graph().endpoints == ())


def test_a_malformed_token_is_ignored(node: OpenNode) -> None:
    token = str(node("watcher").token)
    assert parse_graph(["@ros2_lv/0/strange", token]) == parse_graph([token])


def call(client: ServiceClient, node: Ros2Node, *others: Ros2Node, goal: int = 0) -> list[Any]:
    """Cancel a goal by a service; return its one response."""
    responses: list[Any] = []
    request = node.messages.new(f"{CANCEL_GOAL}_Request")
    request.goal_info.stamp.sec = goal
    client.call(request, 5, lambda response, _: responses.append(response))
    spin_until(lambda: responses, node, *others, now_ns=7)
    return responses


def test_a_service_answers_each_request_with_its_number_and_gid(node: OpenNode) -> None:
    server, caller = node("server"), node("caller")
    sources: list[Attachment] = []

    def answer(request: Request, now_ns: int) -> None:
        sources.append(request.source)
        response = server.messages.new(
            f"{CANCEL_GOAL}_Response", return_code=request.message.goal_info.stamp.sec
        )
        request.reply(response, now_ns)
        with pytest.raises(ValueError, match="/cancel: this request has its response already"):
            request.reply(response, now_ns)

    server.server("cancel", CANCEL_GOAL, answer)
    client = caller.client("cancel", CANCEL_GOAL)
    spin_until(lambda: client.is_available)
    assert [call(client, caller, server, goal=goal)[0].return_code for goal in (3, 2)] == [3, 2]
    assert sources == [Attachment(number, 5, gid(str(client.token))) for number in (1, 2)]


def test_a_call_without_a_server_has_no_response(node: OpenNode) -> None:
    caller = node("caller")
    client = caller.client("cancel", CANCEL_GOAL)
    assert not client.is_available
    assert call(client, caller) == [None]


def test_a_call_to_a_server_that_leaves_has_no_response(node: OpenNode) -> None:
    server, caller = node("server"), node("caller")
    requests: list[Request] = []
    server.server("cancel", CANCEL_GOAL, lambda request, _: requests.append(request))
    client = caller.client("cancel", CANCEL_GOAL)
    spin_until(lambda: client.is_available)
    responses: list[Any] = []
    client.call(
        caller.messages.new(f"{CANCEL_GOAL}_Request"), 5, lambda response, _: responses.append(response)
    )
    spin_until(lambda: requests, server)
    server.close()
    spin_until(lambda: responses, caller)
    assert responses == [None]


def test_a_reply_to_a_client_that_has_left_is_dropped(node: OpenNode) -> None:
    server, caller = node("server"), node("caller")
    requests: list[Request] = []
    server.server("cancel", CANCEL_GOAL, lambda request, _: requests.append(request))
    client = caller.client("cancel", CANCEL_GOAL)
    spin_until(lambda: client.is_available)
    client.call(
        caller.messages.new(f"{CANCEL_GOAL}_Request"), 5, lambda *_: pytest.fail("the client has left")
    )
    spin_until(lambda: requests, server)
    caller.close()
    spin_until(lambda: len(server.graph().nodes) == 1)
    requests[0].reply(server.messages.new(f"{CANCEL_GOAL}_Response"), 6)


def test_a_malformed_request_is_counted_and_gets_no_response(node: OpenNode, router: str) -> None:
    server = node("server")
    service = server.server(
        "cancel", CANCEL_GOAL, lambda *_: pytest.fail("a malformed request was handed on")
    )
    with open_client(router) as stranger:
        route = stranger.declare_querier(service.key)
        spin_until(lambda: route.matching_status.matching)
        replies = stranger.get(service.key, payload=b"\0\1\0\0", target=zenoh.QueryTarget.ALL_COMPLETE)
        spin_until(lambda: service.rejected, server)
        assert list(replies) == []
    assert "none instead of 33 bytes" in server.rejected["/cancel"]


def test_nodes_find_each_other_again_after_the_router_has_restarted() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    router = open_router(address)
    received: Received = []
    with Ros2Node("sender", router=address) as sender, Ros2Node("receiver", router=address) as receiver:
        receiver.subscription("chatter", names.STRING, DEFAULT, collect(received))
        publisher = sender.publisher("chatter", names.STRING)
        wait_for_subscription(publisher)
        assert receiver.is_connected
        router.close()
        spin_until(lambda: not publisher._publisher.matching_status.matching)
        spin_until(lambda: not receiver.is_connected)
        router = open_router(address)
        message = sender.messages[names.STRING](data="again")
        spin_until(lambda: publisher.publish(message, 0) or received, receiver)
        spin_until(lambda: len(receiver.graph().nodes) == 2)
        assert receiver.is_connected
    router.close()


@pytest.fixture
def router_process() -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A router in a process of its own, and its address."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    code = f"""
from protocol.ros2.session import open_router
router = open_router({address!r})
print("open", flush=True)
input()
"""
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"open\n"
        yield address, process
        process.kill()


def test_messages_arrive_again_after_the_router_could_not_keep_up(
    router_process: tuple[str, subprocess.Popen[bytes]],
) -> None:
    address, process = router_process
    received: Received = []
    with Ros2Node("sender", router=address) as sender, Ros2Node("receiver", router=address) as receiver:
        receiver.subscription("chatter", names.STRING, DEFAULT, collect(received))
        publisher = sender.publisher("chatter", names.STRING)
        wait_for_subscription(publisher)
        message = sender.messages[names.STRING](data="x" * 50_000)
        process.send_signal(signal.SIGSTOP)
        for _ in range(400):  # more than the buffers of the connection hold
            publisher.publish(message, 0)
        process.send_signal(signal.SIGCONT)
        last = sender.messages[names.STRING](data="last")
        spin_until(
            lambda: publisher.publish(last, 0) or (received and received[-1][0].data == "last"), receiver
        )


def test_without_a_router_a_node_says_what_to_do() -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{unused.getsockname()[1]}"
        with pytest.raises(ConnectionError, match=r"no Zenoh router answers at .* rmw_zenohd"):
            open_client(address, timeout_s=0.2)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("my node",), "'my node' is not the name of a node"),
        (("murmur", "r-1"), "is not a name of ROS"),
        (("murmur", "/", 500), "domain 500 is not from 0 to 232"),
    ],
)
def test_a_node_with_a_wrong_name_is_refused(arguments: tuple[Any, ...], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Ros2Node(*arguments)
