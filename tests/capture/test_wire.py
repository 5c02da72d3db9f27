"""The meter: bytes on a hub's connections, as the kernel counts them."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator

import pytest

from deploy.record.wire_bytes import Meter


@pytest.fixture
def hub() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        if Meter(_endpoint(server)).read() is None:
            pytest.skip("this kernel does not tell of sockets (sock_diag)")
        yield server


def _endpoint(server: socket.socket) -> str:
    return f"tcp/127.0.0.1:{server.getsockname()[1]}"


def _join(server: socket.socket) -> tuple[socket.socket, socket.socket]:
    client = socket.create_connection(server.getsockname())
    return client, server.accept()[0]


def _say(here: socket.socket, there: socket.socket, size: int) -> None:
    here.sendall(bytes(size))
    while size:
        size -= len(there.recv(size))


def test_it_counts_both_directions_of_all_connections(hub: socket.socket) -> None:
    meter = Meter(_endpoint(hub))
    one, two = _join(hub), _join(hub)
    with one[0], one[1], two[0], two[1]:
        _say(one[0], one[1], 1000)
        assert meter.read() == 1000
        _say(one[1], one[0], 30_000)
        _say(two[0], two[1], 7)
        assert meter.read() == 31_007


def test_it_remembers_connections_that_have_ended(hub: socket.socket) -> None:
    meter = Meter(_endpoint(hub))
    client, server = _join(hub)
    with client, server:
        _say(client, server, 500)
        assert meter.read() == 500
    time.sleep(0.01)
    other, server = _join(hub)
    with other, server:
        _say(other, server, 40)
        assert meter.read() == 540


def test_connections_of_other_processes_are_not_counted(hub: socket.socket) -> None:
    with socket.create_server(("127.0.0.1", 0)) as elsewhere:
        client, server = _join(elsewhere)
        with client, server:
            _say(client, server, 500)
            assert Meter(_endpoint(hub)).read() == 0


def test_a_hub_on_another_host_is_not_counted() -> None:
    assert Meter("tcp/192.0.2.1:7447").read() is None
