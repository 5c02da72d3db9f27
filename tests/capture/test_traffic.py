"""What crosses the wire between processes: all that the ledger books as carried, in order, and nothing else.

A raw socket takes every packet of the loopback while a swarm runs; the TCP streams are put together, Zenoh's
framing is read to the end, and each payload is compared with the capture. Linux, and the right to open raw
sockets: run as root.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pyarrow.parquet
import pytest

from deploy.record import run_directory
from netshaper.ledger import FRAMES
from tests.capture.sniffer import BUFFER, SO_RCVBUFFORCE
from tests.capture.traffic import (
    DOWN,
    PHASES,
    UP,
    CapturedFrame,
    Traffic,
    frames,
    frames_of,
    in_rounds,
    relayed_to,
)

HERE = Path(__file__).parent
ROOT = HERE.parents[1]

SWARMS = {
    "cut by the budget": {"robots": 4, "map_encoding": "polygons", "bandwidth": 300, "range": "40%", "steps": 50},
    "long frames": {
        "robots": 3, "map_encoding": "scans", "bandwidth": "unlimited", "beams": 3600, "range": "10%", "seed": 2,
        "steps": 40,
    },
}  # fmt: skip


@pytest.fixture(scope="module", params=SWARMS)
def traffic(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Traffic:
    if not hasattr(socket, "AF_PACKET"):
        pytest.skip("raw packet sockets are Linux's: this system has none")
    try:
        with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0) as raw:
            raw.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, BUFFER)
    except PermissionError:
        pytest.skip(
            "no right to open a raw socket with a large buffer: run as root to test what crosses the wire"
        )
    folder = tmp_path_factory.mktemp("watched")
    done = subprocess.run(
        [sys.executable, HERE / "watched_swarm.py", folder, json.dumps(SWARMS[request.param])],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return Traffic(folder)


@pytest.fixture(scope="module")
def captured(traffic: Traffic) -> list[CapturedFrame]:
    return frames(traffic.run)


def test_the_sniffer_missed_no_bytes(traffic: Traffic) -> None:
    assert traffic.dropped == 0
    assert len(traffic.connections) == len(traffic.processes) - 1
    for connection in traffic.connections.values():
        for stream in connection.streams:
            assert stream.complete
            assert not stream.missing
        assert connection.session.pending == 0


def test_each_process_has_exactly_one_connection(traffic: Traffic) -> None:
    assert sorted(c.name for c in traffic.connections.values()) == sorted(set(traffic.processes) - {"relay"})
    for name in (f"r{robot}" for robot in traffic.robots):
        held = traffic.processes[name]
        assert held["tcp"] == [[traffic.of(name).port, traffic.hub]]
        assert held["other sockets"] == []
        assert ("token", f"alive/{name}") in traffic.of(name).declared[UP]


def test_no_pipe_runs_from_robot_to_robot(traffic: Traffic) -> None:
    pipes = [(n, mode) for robot in traffic.robots for n, mode in traffic.processes[f"r{robot}"]["pipes"]]
    written = {number for number, mode in pipes if mode != os.O_RDONLY}
    assert not written & {number for number, mode in pipes if mode != os.O_WRONLY}


def test_all_connections_are_to_the_hub(traffic: Traffic) -> None:
    if not traffic.alone:
        pytest.skip(
            "no right to a network namespace: others share this loopback; run as root on a real machine"
        )
    assert traffic.strangers.counts == {}


def test_connections_carry_only_messages_of_their_owner(traffic: Traffic) -> None:
    others = {f"r{robot}" for robot in traffic.robots}
    for connection in traffic.connections.values():
        me = connection.name
        is_robot = me in others
        sent_keys = {key for key, _ in connection.puts[UP]}
        received_keys = {key for key, _ in connection.puts[DOWN]}
        allowed_up = {f"control/tx/{me}", f"control/rx/recorder/{me}"}
        allowed_down = {f"control/rx/{me}/relay"}
        if is_robot:
            allowed_up |= {f"radio/tx/{me}", f"body/rx/world/{me}"}
            allowed_down |= {f"radio/rx/{me}/relay", f"body/rx/{me}/world"}
        elif me == "world":
            allowed_up |= {f"body/rx/{robot}/world" for robot in others}
            allowed_down |= {f"body/rx/world/{robot}" for robot in others}
        else:
            allowed_down |= {f"control/rx/recorder/{name}" for name in {*others, "world", "relay"}}
        assert sent_keys <= allowed_up
        assert received_keys <= allowed_down
        if is_robot:
            listens = {key for kind, key in connection.declared[DOWN] if kind == "subscriber"}
            assert listens == {"*/tx/**", "*/rx/world/**", "*/rx/recorder/**"}, (
                "a robot learns of other subscribers"
            )


def test_the_relay_received_all_frames_of_each_robot_in_order_and_counted_every_byte(
    traffic: Traffic, captured: list[CapturedFrame]
) -> None:
    for robot in traffic.robots:
        messages = traffic.of(f"r{robot}").submitted()
        for (step, round_number), logged in in_rounds([frame for frame in captured if frame.sender == robot]):
            opening = messages.pop((step, round_number, "offers"))
            firsts = [frame for frame in logged if FRAMES[frame.frame] in ("broadcast", "offer")]
            # The relay orders offers differently.
            assert sorted(map(_content, firsts)) == sorted(frames_of(opening))
            for phase, name in (("answer", "answers"), ("data", "data")):
                these = [frame for frame in logged if FRAMES[frame.frame] == phase]
                if (step, round_number, name) not in messages:
                    assert not these
                    continue
                asked = messages.pop((step, round_number, name))
                for frame, (receiver, payload) in zip(these, frames_of(asked), strict=True):
                    assert receiver == _receiver(frame)
                    assert frame.is_payload(payload), (frame, payload.hex())
        assert not any(frames_of(left) for left in messages.values()), (
            f"r{robot} sent frames that the ledger lacks"
        )


def _receiver(frame: CapturedFrame) -> str:
    return "all" if frame.receiver < 0 else f"r{frame.receiver}"


def _content(frame: CapturedFrame) -> tuple[str, bytes]:
    assert frame.is_payload(frame.known)
    return _receiver(frame), frame.known


def test_each_robot_received_exactly_the_carried_frames_in_order(
    traffic: Traffic, captured: list[CapturedFrame]
) -> None:
    for robot in traffic.robots:
        assert traffic.of(f"r{robot}").radio(DOWN) == relayed_to(captured, robot)


def test_bytes_on_the_wire_equal_those_of_the_ledger(traffic: Traffic, captured: list[CapturedFrame]) -> None:
    ledger = pyarrow.parquet.read_table(traffic.run / run_directory.LEDGER).to_pylist()
    submitted = sum(
        len(payload)
        for robot in traffic.robots
        for each in traffic.of(f"r{robot}").submitted().values()
        for _, payload in frames_of(each)
    )
    down = sum(len(payload) for robot in traffic.robots for _, payload in traffic.of(f"r{robot}").radio(DOWN))
    carried = [row for row in ledger if row["carried"]]
    truncated = [
        row
        for row in ledger
        if not row["carried"] and row["frame"] in PHASES[1:3] and row["cause"] == "budget"
    ]
    assert submitted == sum(row["bytes"] for row in ledger)
    assert down == sum(row["bytes"] * row["received_by"] for row in carried) + sum(
        row["bytes"] for row in truncated
    )
    assert sum(frame.carried for frame in captured) == sum(row["bytes"] for row in carried) > 0


def test_long_messages_are_fragmented_and_joined(traffic: Traffic, captured: list[CapturedFrame]) -> None:
    longest = max(frame.carried for frame in captured)
    fragmented = sum(traffic.of(f"r{robot}").session.fragmented for robot in traffic.robots)
    if longest > 1 << 16:
        assert fragmented > 0
    else:
        assert fragmented == 0, "no other message is so long: maps are handed in in parts"


def test_each_byte_of_the_radio_crosses_the_wire_twice(
    traffic: Traffic, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = run_directory.read_summary(traffic.run)
    bytes_of = traffic.overhead()
    assert sum(bytes_of.values()) > 2 * summary["bytes"]["total"]
    with capsys.disabled():
        print(f"\n{describe(bytes_of, summary['bytes']['total'])}")


def describe(bytes_of: Counter[str], on_air: int) -> str:
    total = sum(bytes_of.values())
    parts = ", ".join(f"{what} {size}" for what, size in sorted(bytes_of.items()))
    share = 100 * bytes_of["bus"] / total
    return f"{total} bytes on TCP: {parts}; {on_air} bytes on the air; the bus itself adds {share:.1f} %"
