"""The dissector: every packet by name and field, the ledger's sums, and malformed bytes without Lua errors."""

from __future__ import annotations

import random
from collections import Counter
from pathlib import Path
from typing import Any

import msgspec
import pytest

from deploy.record import run_directory
from deploy.run.in_memory import MemoryRun
from deploy.scenario import plan as plans
from deploy.scenario.scenario import parse
from netshaper import capture
from netshaper.capture import KEPT, VERDICTS
from netshaper.ledger import CAUSES, EVERYONE
from protocol import packet_codec, packets
from protocol.errors import ProtocolError
from protocol.packets import ALL_KINDS, Fragment, Packet, Update
from tests.agent.encodings.names import EXACT
from tests.capture import tshark as tsharks
from tests.capture.tshark import Tshark
from tests.netshaper import plain_ledger
from tests.netshaper.plain_ledger import LoggedFrame

GOLDEN = Path(__file__).parents[1] / "protocol" / "golden" / "packets.txt"
VALUES = ("index", "x", "y", "side", "occupied", "object", "count", "inside", "block", "leads", "data",
          "robot", "age", "sum", "number", "entries", "complete", "salt", "hash")  # fmt: skip
DATA, BUDGET = 2, 1


@pytest.fixture(scope="module")
def tshark(tmp_path_factory: pytest.TempPathFactory) -> Tshark:
    return tsharks.find(tmp_path_factory.mktemp("home"))


KINDS: list[type[Packet]] = [
    getattr(packets, name) for name in dict.fromkeys(layout.packet for layout in packets.LAYOUTS)
]
"""All kinds of packets."""


def drawn(kind: type[Packet], chance: random.Random) -> bytes:
    """A packet of one kind: all bits of its fields set, or none, or drawn."""
    if kind is Fragment:
        return packet_codec.encode([Fragment(chance.randbytes(chance.randint(1, packets.FRAGMENT_DATA)))])
    if kind is Update:
        number = chance.choice((None, *range(packets.UPDATE_NUMBERS)))
        least = packets.UPDATE_PART if number is None else 0
        data = chance.randbytes(chance.randint(least, packets.UPDATE_DATA))
        return packet_codec.encode([Update(number, data)])
    (layout,) = [layout for layout in packets.LAYOUTS if layout.packet == kind.__name__]
    width = sum(bits.width for _, bits in layout.fields)
    fields = chance.choice((0, (1 << width) - 1, chance.getrandbits(width))) if width else 0
    return ((int(kind.code, 2) << width | fields) << layout.spare).to_bytes(kind.size, "big")


def captured_frame(payload: bytes, verdict: int = 0) -> LoggedFrame:
    return LoggedFrame(1, 7, DATA, 3, 5, 2, verdict, 0b100000, payload)


def encoded(step: int, seen: list[LoggedFrame]) -> bytes:
    return capture.encode(step, plain_ledger.log_of(seen))


def write(file: Path, payloads: list[bytes]) -> Path:
    file.write_bytes(capture.head("a test") + encoded(9, [captured_frame(payload) for payload in payloads]))
    return file


def test_every_packet_is_shown_by_name_and_field(tshark: Tshark, tmp_path: Path) -> None:
    chance = random.Random(1)
    golden = [
        bytes.fromhex(line.split("  ")[0]) for line in GOLDEN.read_text().splitlines() if line[0] != "#"
    ]
    payloads = golden + [drawn(kind, chance) for kind in KINDS for _ in range(30)]
    names = [
        "murmur.packet",
        "murmur.kind",
        "murmur.size",
        "murmur.map",
        *(f"murmur.{name}" for name in VALUES),
    ]
    rows = tshark.fields(write(tmp_path / "all.pcapng", payloads), names)
    for payload, (layout, kind, size, map_id, *values) in zip(payloads, rows, strict=True):
        (packet,) = packet_codec.decode(payload)
        assert layout == [type(packet).__name__]
        assert kind == [packet.name]
        assert size == [str(len(payload))]
        wanted: dict[str, Any] = msgspec.structs.asdict(packet)
        assert map_id == ["2", str(wanted.pop("map"))] if "map" in wanted else ["2"]
        found = {name: value[0] for name, value in zip(VALUES, values, strict=True) if value}
        there = {name: v for name, v in wanted.items() if v not in (None, b"")}
        assert found == {name: v.hex() if isinstance(v, bytes) else str(v) for name, v in there.items()}


def test_the_header_is_shown_field_by_field(tshark: Tshark, tmp_path: Path) -> None:
    file = tmp_path / "head.pcapng"
    sent = [
        LoggedFrame(1, 70000, DATA, 63, 0, 62, 0, 1 << 63 | 1, b"\xf0"),
        LoggedFrame(0, -1, 3, 4, EVERYONE, -1, 0, 0b101, b"\x00\x00\x00"),
        LoggedFrame(0, -1, 0, 4, -99, -1, 2, 0, b"\xc0\x00"),
        LoggedFrame(0, 3, 2, 255, 64, 200, 0, 1 << 255 | 1 << 64 | 1, b"\xf0"),
        LoggedFrame(0, -1, 0, 4, 100, -1, 2, 0, b"\xc0\x00"),
    ]
    file.write_bytes(capture.head("a test") + encoded(86401, sent))
    names = (
        "step",
        "round",
        "connection",
        "frame",
        "sender",
        "receiver",
        "map",
        "part",
        "verdict",
        "received_by",
        "bytes",
    )
    rows = tshark.fields(file, ["frame.time_epoch", "frame.comment", *(f"murmur.{name}" for name in names)])
    assert [[",".join(cell) for cell in row] for row in rows] == [
        ["86401.000000000", "delivered", "86401", "1", "70000", "2", "63", "0", "62", "0", "0", "0,63", "1"],
        [
            "86401.000001000",
            "delivered to r0, r2",
            "86401",
            "0",
            "-1",
            "3",
            "4",
            "-1",
            "-1",
            "0",
            "0",
            "0,2",
            "3",
        ],
        ["86401.000002000", "out of range", "86401", "0", "-1", "0", "4", "-99", "-1,0", "0", "2", "", "2"],
        [
            "86401.000003000",
            "delivered",
            "86401",
            "0",
            "3",
            "2",
            "255",
            "64",
            "200",
            "0",
            "0",
            "0,64,255",
            "1",
        ],
        ["86401.000004000", "out of range", "86401", "0", "-1", "0", "4", "100", "-1,0", "0", "2", "", "2"],
    ]
    columns = tshark.run("-r", file).splitlines()
    for text in ("r63", "r0", "MURMUR", "data of map 62: 1 save (1 bytes), carried"):
        assert text in columns[0]
    assert "r4 " in columns[1]
    assert " all " in columns[1]
    assert " unknown " in columns[2]


def test_the_dissector_accepts_exactly_the_packets_that_the_decoder_reads(
    tshark: Tshark, tmp_path: Path
) -> None:
    chance = random.Random(2)
    whole = [drawn(kind, chance) for kind in KINDS for _ in range(2)]
    payloads = [packet[:end] for packet in whole for end in range(len(packet))]
    payloads += [bytes([first]) for first in range(256)] + [bytes([first, 0]) for first in range(256)]
    payloads += [chance.randbytes(chance.randint(1, 80)) for _ in range(600)]
    payloads += [chance.choice(whole) + chance.choice(whole) + chance.randbytes(9) for _ in range(300)]
    rows = tshark.fields(
        write(tmp_path / "bad.pcapng", payloads), ["murmur.kind", "murmur.broken", "murmur.spare"]
    )
    for payload, (kinds, broken, spare) in zip(payloads, rows, strict=True):
        sent: list[str] = []
        error, at = "", 0
        try:
            while packet := packet_codec.packet_at(payload, at):
                sent.append(packet.name)
                at += packet_codec.length(payload, at)
            packet_codec.decode(payload)
        except ProtocolError as caught:
            error = str(caught)
        assert bool(broken or spare) == bool(error), (payload.hex(), error)
        assert kinds[: len(sent)] == sent, payload.hex()


def test_a_malformed_header_causes_no_lua_error(tshark: Tshark, tmp_path: Path) -> None:
    chance = random.Random(3)
    head = plain_ledger.HEAD.pack(capture.VERSION, 2, 0, 0, 0, 1, 0, 0, 1, 0, 2)
    blocks = [plain_ledger.packet(n, head[:n], n, "") for n in range(1, plain_ledger.HEAD.size)]
    blocks += [plain_ledger.packet(n, chance.randbytes(n), n, "") for n in range(24, 60)]
    blocks += [plain_ledger.packet(n, b"\x01" + chance.randbytes(n), n + 1, "") for n in range(23, 400)]
    blocks += [plain_ledger.packet(n, head + b"\x40" * 9, 24 + 9 + n, "") for n in range(9)]
    file = tmp_path / "heads.pcapng"
    file.write_bytes(capture.head("a test") + b"".join(blocks))
    assert len(tshark.fields(file, ["murmur.broken"])) == len(blocks)
    shown = tshark.run("-r", file, "-V")
    assert "lua" not in shown.lower()
    assert "no header of version 1 or 2" in shown


def test_truncated_frames_are_no_error(tshark: Tshark, tmp_path: Path) -> None:
    payload = packet_codec.encode([Fragment(bytes(50))] * 9)
    file = tmp_path / "truncated.pcapng"
    file.write_bytes(capture.head("a test") + encoded(1, [captured_frame(payload, BUDGET)]))
    names = ["murmur.bytes", "murmur.truncated", "murmur.kind", "murmur.broken", "murmur.refused"]
    ((sent, truncated, kinds, broken, refused),) = tshark.fields(file, names)
    assert (sent, truncated) == ([str(len(payload))], [str(len(payload) - KEPT)])
    assert (kinds, broken) == (["scan"], [])
    assert refused


@pytest.mark.parametrize("map_encoding", [name for name in EXACT if name != "none"])
def test_sums_equal_those_of_the_ledger(tshark: Tshark, tmp_path: Path, map_encoding: str) -> None:
    settings = {"robots": 4, "map_encoding": map_encoding, "dissemination": "backoff", "strategy": "meier"}
    plan = plans.make(parse(settings | {"bandwidth": 400, "range": "40%", "steps": 60}))
    with run_directory.open_capture(tmp_path, plan) as file:
        ledger = MemoryRun(plan, file).complete().ledger()
    rows = tshark.fields(
        tmp_path / run_directory.CAPTURE,
        ["murmur.verdict", "murmur.bytes", "murmur.kind", "murmur.size", "murmur.broken"],
    )
    sums: Counter[tuple[str, str]] = Counter()
    for (verdict,), (sent,), kinds, sizes, broken in rows:
        assert not broken
        if verdict == "0":
            for kind, size in zip(kinds, sizes, strict=True):
                sums[kind, "packets"] += 1
                sums[kind, "bytes"] += int(size)
        else:
            sums[VERDICTS[int(verdict)], "bytes"] += int(sent)
    wanted: Counter[tuple[str, str]] = Counter()
    for row in ledger:
        if row["carried"]:
            wanted[ALL_KINDS[row["kind"]], "packets"] += int(row["packets"])
            wanted[ALL_KINDS[row["kind"]], "bytes"] += int(row["bytes"])
        else:
            wanted[CAUSES[row["cause"]], "bytes"] += int(row["bytes"])
    assert sums == wanted
    assert wanted["conn", "bytes"] > 0
    assert wanted["budget", "bytes"] > 0
