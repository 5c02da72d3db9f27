"""UDP between network namespaces: one interface, one hop, and a team with loss and a partition."""

from __future__ import annotations

import select
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.radios.options import LinkOptions
from agent.radios.transport import Transport, TransportError
from agent.radios.udp import GROUP, MAX_DATAGRAM, PORT, UdpRadio
from protocol.keyed_random import keyed_random
from protocol.nanoseconds import SECOND
from tests.agent.radios.air_team import AirTeam, assert_maps_agree, exchange_all
from tests.agent.radios.namespaces import BROADCAST, INTERFACE, Hosts, hosts, why_not
from tests.agent.radios.test_teams_on_the_air import TEAM
from tests.system.team import Team, small_plan

REASON = why_not()
needs_namespaces = pytest.mark.skipif(bool(REASON), reason=REASON)
PATIENCE_S = 5
_IP_RECVTTL = 12
"""Of Linux; the module `socket` does not have it."""


@pytest.fixture(scope="module")
def net() -> Iterator[Hosts]:
    with hosts(4) as made:
        yield made


def radio(net: Hosts, number: int, interface: str = INTERFACE, address: str = GROUP) -> UdpRadio:
    return net.on(number, lambda: UdpRadio(interface, address))


def arrived(end: UdpRadio) -> list[bytes]:
    assert select.select([end], [], [], PATIENCE_S)[0]
    return end.receive()


def assert_arrives(frame: bytes, sender: UdpRadio, receiver: UdpRadio) -> None:
    """Send a frame until it arrives: an interface that has just been set up drops the first ones."""
    for _ in range(10 * PATIENCE_S):
        assert sender.send(frame)
        if select.select([receiver], [], [], 0.1)[0]:
            break
    assert set(receiver.receive()) == {frame}


@needs_namespaces
@pytest.mark.parametrize("address", [GROUP, BROADCAST])
def test_a_frame_reaches_all_others_once_and_not_its_sender(net: Hosts, address: str) -> None:
    ends = [radio(net, number, address=address) for number in (0, 1, 2, 2)]
    for frame in (b"frame", b"frame", b"\0" * MAX_DATAGRAM):
        assert ends[2].send(frame)
        for other in (0, 1, 3):  # the last one is another robot on the same host
            assert arrived(ends[other]) == [frame]
        assert ends[2].receive() == []
    assert not ends[2].send(b"\0" * (MAX_DATAGRAM + 1))
    for end in ends:
        end.close()


@needs_namespaces
def test_nothing_is_sent_or_received_on_another_interface(net: Hosts) -> None:
    net.second_interface(0, 1)
    one, two, other = radio(net, 0), radio(net, 1), radio(net, 1, "other0")
    stranger = radio(net, 0, "other0")
    assert stranger.send(b"from the other interface")
    assert arrived(other) == [b"from the other interface"]
    assert one.send(b"from the right one")
    assert arrived(two) == [b"from the right one"]
    assert other.receive() == two.receive() == []
    for end in (one, two, other, stranger):
        end.close()


@needs_namespaces
@pytest.mark.parametrize("address", [GROUP, "10.78.0.255"])
def test_an_interface_that_was_removed_is_used_again_once_it_is_back(net: Hosts, address: str) -> None:
    net.second_interface(2, 3)
    one, two = radio(net, 2, "other0", address), radio(net, 3, "other0", address)
    assert_arrives(b"before", one, two)
    net.unplug_second_interface(2)
    for _ in range(2):
        assert not net.on(2, lambda: one.send(b"lost"))
    net.second_interface(2, 3)
    for number, end in ((2, one), (3, two)):
        assert not net.on(number, lambda end=end: end.send(b"opens it again"))
    assert_arrives(b"after", one, two)
    for end in (one, two):
        end.close()
    net.unplug_second_interface(2)


@needs_namespaces
def test_datagrams_are_not_forwarded_and_only_the_group_is_listened_to(net: Hosts) -> None:
    def listen() -> socket.socket:
        listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.IPPROTO_IP, _IP_RECVTTL, 1)
        listener.bind((BROADCAST, PORT))
        listener.settimeout(PATIENCE_S)
        return listener

    def send_to_one() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plain:
            plain.sendto(b"to one host", (net.address(3), PORT))

    with net.on(1, listen) as listener:
        end = radio(net, 0, address=BROADCAST)
        assert end.send(b"frame")
        _, ancillary, _, _ = listener.recvmsg(100, 100)
        assert [int.from_bytes(data, "little") for _, kind, data in ancillary if kind == socket.IP_TTL] == [1]
        end.close()
    receiver, sender = radio(net, 3), radio(net, 2)
    net.on(2, send_to_one)
    assert sender.send(b"to the group")
    assert arrived(receiver) == [b"to the group"]
    receiver.close()
    sender.close()


def test_interfaces_and_addresses_that_do_not_exist_are_refused() -> None:
    with pytest.raises(TransportError, match=r"interface 'radio9' does not exist; there are: .*lo"):
        UdpRadio("radio9")
    for name in ("radio\0", "\ud800", "r" * 300):
        with pytest.raises(TransportError, match="does not exist"):
            UdpRadio(name)
    with pytest.raises(TransportError, match="no IPv4 address"):
        UdpRadio("lo", "group")
    with pytest.raises(TransportError, match=r"on interface lo: .*is the interface up"):
        UdpRadio("lo", "192.0.2.7")


class Lossy:
    """A transport that loses a tenth of the frames that arrive."""

    def __init__(self, transport: Transport, number: int) -> None:
        self.send, self.fileno, self.close = transport.send, transport.fileno, transport.close
        self._transport, self._number, self._frames = transport, number, 0

    def receive(self) -> list[bytes]:
        return [frame for frame in self._transport.receive() if not self._is_lost()]

    def _is_lost(self) -> bool:
        self._frames += 1
        return bool(keyed_random(5, "lossy", self._number, self._frames).random() < 0.1)


def cut_off(net: Hosts, folder: Path, **settings: Any) -> tuple[AirTeam, int]:
    """A team that has explored over UDP with loss and a partition, and the bytes of the same team behind a relay."""
    options = LinkOptions("udp", interface=INTERFACE, bytes_per_s=1000)

    def join(number: int) -> Transport:
        return Lossy(net.on(number, options.open_transport), number)

    def set_time(now: int) -> None:
        if now in (15 * SECOND, 75 * SECOND):
            net.plug(in_=now > 15 * SECOND)

    team = AirTeam(small_plan(robots=4, **TEAM | settings), options, join, folder, set_time)
    team.explore(300)
    exchange_all(team, 300)
    team.close()
    assert_maps_agree(team)

    partition = [{"first": 15, "last": 74, "groups": [[0, 1]]}]
    radio = {"loss": 0.1, "partition": partition}
    relayed = Team(small_plan(robots=4, bandwidth=4 * options.rate, radio=radio, **TEAM | settings))
    relayed.explore(300)
    while any(robot.replication.undelivered() for robot in relayed.robots):
        relayed.stand(dict(relayed.world.cells))
        assert relayed.step < 600
    rows = relayed.ledger()
    return team, int(rows["bytes"][rows["carried"] == 1].sum())


@needs_namespaces
def test_four_robots_agree_after_a_tenth_of_loss_and_a_minute_of_partition(
    net: Hosts, tmp_path: Path
) -> None:
    team, relayed = cut_off(net, tmp_path)
    assert np.count_nonzero(team.robots[0].planning) > 2000
    assert team.sent_packet_bytes() <= 1.3 * relayed


@pytest.mark.long
@needs_namespaces
def test_six_teams_send_few_more_bytes_than_behind_a_relay(net: Hosts, tmp_path: Path) -> None:
    sent = relayed = 0
    for seed in range(6):
        team, behind_relay = cut_off(net, tmp_path / str(seed), seed=seed, side_m=20.0)
        sent, relayed = sent + team.sent_bytes(), relayed + behind_relay
    print(f"bytes over UDP and behind a relay: {sent}, {relayed}, ratio {sent / relayed:.3f}")
    assert sent <= 1.3 * relayed
