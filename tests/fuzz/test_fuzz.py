"""Fuzzing: any bytes are read or rejected with an error message; briefly here, ten minutes with ``make fuzz``.

Each reader has its error type. Inputs of earlier failures are files in ``corpus``; all readers read them first.
"""

from __future__ import annotations

import os
import struct
import tomllib
from collections.abc import Callable
from dataclasses import fields
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from PIL import Image

from agent.encoding_options import PolygonOptions
from agent.encodings.catalog import ENCODINGS, make_encoding
from agent.identity import Identity
from agent.journal import Journal, JournalError
from agent.outline.receiver import Receiver
from agent.radio_events import respond
from agent.radios.cobs import LineReader, line, stuff, unstuff
from agent.radios.options import LinkOptions
from agent.radios.peer_medium import PeerMedium
from agent.radios.sealing import KEY_BYTES, Opener, Sealer
from agent.radios.session_file import SessionFile, SessionFileError
from agent.radios.team_key import KeyFileError, read_key
from agent.replication.base import Replication
from agent.robot import Robot
from agent.settings import EncodingSettings, MediumSettings, ReplicationSettings, Settings
from deploy.record import missed_phases
from deploy.record.link_records import FRAMES, FrameLine, read_frames
from deploy.scenario import plan as plans
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import Scenario, parse
from deploy.scenario.toml_files import lay
from netshaper.radio_options import RadioOptions
from protocol import packet_codec, packet_index
from protocol.body import Body
from protocol.budget import Budget
from protocol.errors import ProtocolError
from protocol.keys import Keys
from protocol.message_codec import unpack
from protocol.messages import ConnectionReport, Delivery, Missed, Record, RoundReport
from protocol.packets import LAYOUTS
from protocol.range_scans import Laser, range_scan_size
from protocol.rights import RIGHTS, read
from protocol.scans import fragments
from protocol.zenoh_bus import Credential
from tests.agent.replication.network import make_engine
from worldsim import maps
from worldsim.maps import MapError

CORPUS = sorted((Path(__file__).parent / "corpus").iterdir())
EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "60"))
"""How many inputs each reader gets."""

SETTINGS = Settings(
    robot=1, bodies=(Body(8.0, 360.0, 5.0),) * 3, width=40, height=30, beams=36, seed=0, strategy="meier",
    encoding=EncodingSettings("polygons"), replication=ReplicationSettings("backoff"),
    medium=MediumSettings(Budget(1000), 50.0), incarnations=2,
)  # fmt: skip


LASER = Laser(5, 0, 50_000, 8000)
WITH_LASERS = replace(SETTINGS, bodies=(replace(SETTINGS.body, laser=LASER),) * 3)
KEY = bytes(range(KEY_BYTES))


def read_packets(data: bytes) -> None:
    assert b"".join(packet_index.split(data)) == data
    for packet in packet_codec.decode(data):
        assert packet_codec.decode(packet_codec.encode([packet])) == [packet]


def read_messages(data: bytes) -> None:
    assert isinstance(unpack(data), Record)


def read_as_each_participant(data: bytes) -> None:
    keys = Keys("run")
    for sender, receiver in RIGHTS:
        names = [name.replace("robot", "r1") for name in (receiver, sender)]
        key = keys.control_tx(names[1]) if receiver == "relay" else keys.control(*names)
        try:
            read(key, data)
        except ProtocolError:
            continue


def read_polygons(data: bytes) -> None:
    receiver = Receiver((30, 40))
    for at in range(0, len(data), 7):
        receiver.feed(data[at : at + 7])


def apply_entries(data: bytes) -> None:
    for name, kind in ENCODINGS.items():
        settings = WITH_LASERS if kind.needs_range_scans else SETTINGS
        encoding = make_encoding(replace(settings, encoding=EncodingSettings(name)))
        try:
            encoding.apply(0, data, step=1000, sender=0)
        except ProtocolError:
            continue


def apply_range_scans(data: bytes) -> None:
    """Apply the bytes as whole scans at positions on the grid and around it, as an author would fragment them."""
    encoding = make_encoding(replace(WITH_LASERS, encoding=EncodingSettings("scans")))
    size = range_scan_size(LASER)
    scan = (data + bytes(size))[:size]
    near = scan[1:4] + scan[5:8]
    for place in (b"\0\0" + near[:2] + b"\0\0" + near[2:4], scan[:8]):
        encoding.apply(0, b"".join(fragments(place + scan[8:])), step=1000, sender=0)


def engine(dissemination: str) -> Replication:
    return make_engine(1, 3, lambda *received: packet_index.ends(received[-1]), dissemination, incarnations=2)


def receive_offer(data: bytes) -> None:
    replication = engine("backoff")
    replication.open_round(0, [0, 2], None)
    assert len(replication.answer([Delivery(0, data, 0)])) == 1
    assert not replication.close_round(RoundReport(1, 0, [ConnectionReport(0, 2, 2, 0)], [], [], False))


def receive_gossip(data: bytes) -> None:
    replication = engine("gossip")
    replication.open_round(0, [0, 2], None)
    replication.close_round(RoundReport(1, 0, [], [], [Delivery(0, data)], False))


def read_journal(data: bytes) -> None:
    Identity(Journal(BytesIO(data))).begin(SETTINGS)
    framed = BytesIO()
    Journal(framed).append(data)
    Identity(Journal(framed)).begin(SETTINGS)


def read_scenario(data: bytes) -> None:
    try:
        table = tomllib.loads(data.decode())
    except (UnicodeDecodeError, tomllib.TOMLDecodeError):
        return
    assert parse(parse(table).model_dump()) == parse(table)


def read_credential(data: bytes) -> None:
    Credential.parse(data.decode(errors="replace"))


def read_map(data: bytes, folder: Path) -> None:
    path = folder / "map.yaml"
    path.write_bytes(data)
    (folder / "map.pgm").write_bytes(b"P5 2 2 255\n" + bytes([0, 254, 205, 254]))
    maps.load(str(path))


def read_serial_lines(data: bytes) -> None:
    reader = LineReader(40)
    frames = reader.feed(data)
    assert all(len(frame) <= 40 for frame in frames)
    assert unstuff(stuff(data)) == data
    assert [data[:40]] == reader.feed(b"\0" + line(data[:40]))


def receive_frames(data: bytes) -> None:
    """Receive the bytes as a frame, and as packets that a teammate has sealed."""
    options = LinkOptions("udp", interface="lo", frame_bytes=1400)
    medium = PeerMedium(
        0, 1400, Sealer(KEY, 0, 1), Opener(KEY, 0, 3), options.pacer(0, 0, 0), options.timing()
    )
    robot = Robot(replace(SETTINGS, robot=0, replication=ReplicationSettings("gossip", requires_acks=True)))
    for frame in (data, Sealer(KEY, 1, 1).seal(data), Sealer(KEY, 2, 1).seal(bytes([len(data)]) + 2 * data)):
        medium.receive(frame, 1)
    for event in medium.end_step():
        respond(robot, event, lambda error: None)
    assert len(medium.records) <= 2


def read_settings(data: bytes) -> None:
    assert Settings.decode(Settings.decode(data).encode()) == Settings.decode(data)


def read_session_file(data: bytes) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "r0.session"
        session = SessionFile(path, KEY, 0, 2)
        session.close()
        whole = session.path.read_bytes()
        session.path.write_bytes(data if len(data) < len(whole) else whole[:8] + data[: len(whole) - 8])
        session = SessionFile(path, KEY, 0, 2)
        session.close()
        assert session.session >= 1


def read_key_file(data: bytes) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "team.key"
        path.write_bytes(data)
        path.chmod(0o600)
        assert len(read_key(path)) == KEY_BYTES


def read_frame_list(data: bytes) -> None:
    head = ",".join(FrameLine._fields).encode()
    with TemporaryDirectory() as folder:
        (Path(folder) / FRAMES).write_bytes(head + b"\n" + data)
        read_frames(Path(folder))


READERS: dict[Callable[[bytes], None], type[Exception]] = {
    read_packets: ProtocolError,
    read_messages: ProtocolError,
    read_as_each_participant: ProtocolError,
    read_polygons: ProtocolError,
    apply_entries: ProtocolError,
    apply_range_scans: ProtocolError,
    receive_offer: ProtocolError,
    receive_gossip: ProtocolError,
    read_journal: JournalError,
    read_scenario: ScenarioError,
    read_credential: ValueError,
    read_serial_lines: ProtocolError,
    receive_frames: ProtocolError,
    read_settings: ProtocolError,
    read_session_file: SessionFileError,
    read_key_file: KeyFileError,
    read_frame_list: ValueError,
}

KINDS = bytes(int(layout.code[:8].ljust(8, "0"), 2) for layout in LAYOUTS)
"""A first byte of each kind of packet."""
some_packets = st.lists(
    st.tuples(st.sampled_from(list(KINDS)), st.binary(min_size=1, max_size=8)), max_size=8
).map(lambda pieces: b"".join(bytes([code]) + rest for code, rest in pieces))
some_messages = st.lists(st.integers(0, 30) | st.binary(max_size=4) | st.text(max_size=4), max_size=8).map(
    lambda items: struct.pack("B", 0x90 | len(items)) + b"".join(_packed(item) for item in items)
)
some_toml = st.lists(
    st.tuples(
        st.sampled_from(
            ["robots", "map", "range", "bandwidth", "fault", "radio", "starts", "steps", "map_encoding"]
        ),
        st.sampled_from(
            [
                "3",
                "-1",
                '"x"',
                "1e999",
                "nan",
                "[]",
                "[[1, 2]]",
                '[{step = 1, robot = 0, kind = "kill"}]',
                "{}",
                '"predictive"',
            ]
        ),
    ),
    max_size=4,
    unique_by=lambda pair: pair[0],
).map(lambda pairs: "\n".join(f"{key} = {value}" for key, value in pairs).encode())
EXTREMES = (
    0, 1, -1, 2**31, 2**53, 2**64, 10**30, 0.5, 1e-300,
    1e300, float("inf"), float("nan"), True, False, "", "yes", "0.5",
    "1e300%", "\0", 3000 * "a", [], [1], [["0"], [1]], {}, {"a": 1}, [{}],
)  # fmt: skip
TABLES = {
    "radio": [item.name for item in fields(RadioOptions)],
    "polygons": [item.name for item in fields(PolygonOptions)],
    "predictive": ["base"],
    "map_options": ["resolution", "width_m", "seed", "name"],
}
some_settings = st.dictionaries(
    st.sampled_from(
        [*Scenario.model_fields, *(f"{table}.{key}" for table in TABLES for key in TABLES[table])]
    ),
    st.sampled_from(EXTREMES),
    max_size=3,
)
"""Settings of any type and size, by their dotted names."""
anything = st.binary(max_size=120) | some_packets | some_messages | some_toml


def _packed(item: object) -> bytes:
    if isinstance(item, int):
        return bytes([item])
    text = item.encode() if isinstance(item, str) else item
    assert isinstance(text, bytes)
    return (bytes([0xD9, len(text)]) if isinstance(item, str) else bytes([0xC4, len(text)])) + text


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.__name__)
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=anything)
def test_any_bytes_are_read_or_rejected_with_a_message(reader: Callable[[bytes], None], data: bytes) -> None:
    try:
        reader(data)
    except READERS[reader] as error:
        assert str(error)


@pytest.mark.parametrize("file", CORPUS, ids=lambda file: file.name)
def test_inputs_of_earlier_failures_are_read_or_rejected(file: Path) -> None:
    for reader, refusal in READERS.items():
        try:
            reader(file.read_bytes())
        except refusal as error:
            assert str(error)


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
@given(settings=some_settings)
def test_any_settings_give_a_plan_or_are_rejected_with_a_message(settings: dict[str, Any]) -> None:
    try:
        data: dict[str, Any] = {"map": "em", "bus": "memory"}
        lay(data, settings, "scenario")
        plans.make(parse(data))
    except ScenarioError as error:
        assert 0 < len(str(error)) < 5000


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    kind=st.sampled_from(["L", "P", "1", "RGBA"]),
    suffix=st.sampled_from(["png", "pgm"]),
    cuts=st.lists(st.tuples(st.integers(0, 200), st.integers(0, 8), st.binary(max_size=4)), max_size=3),
)
def test_any_picture_is_read_or_rejected_with_a_message(
    tmp_path_factory: pytest.TempPathFactory, kind: str, suffix: str, cuts: list[tuple[int, int, bytes]]
) -> None:
    """`cuts`: place, length, and replacement of bytes of a valid picture."""
    file = BytesIO()
    picture = Image.new("L", (9, 9), 255).convert(kind if suffix == "png" else "L")
    picture.save(file, "PNG" if suffix == "png" else "PPM")
    data = bytearray(file.getvalue())
    for place, length, replacement in cuts:
        data[place : place + length] = replacement
    path = tmp_path_factory.mktemp("picture") / f"map.{suffix}"
    path.write_bytes(data)
    try:
        maps.load_picture(path, 0.1)
    except MapError as error:
        assert str(error)


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    data=st.binary(max_size=60)
    | st.lists(
        st.tuples(
            st.sampled_from(
                ["image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh", "mode"]
            ),
            st.sampled_from(
                [
                    "map.pgm",
                    "0.1",
                    "[0, 0, 0]",
                    "0",
                    "0.65",
                    "0.2",
                    "trinary",
                    "-1",
                    "[]",
                    "{a: b}",
                    "1e309",
                    "&a [*a]",
                ]
            ),
        ),
        max_size=7,
    ).map(lambda pairs: "\n".join(f"{key}: {value}" for key, value in pairs).encode())
)
def test_any_map_is_read_or_rejected_with_a_message(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    try:
        read_map(data, tmp_path_factory.mktemp("map"))
    except MapError as error:
        assert str(error)


CUTS = st.lists(st.tuples(st.integers(0, 2000), st.integers(0, 8), st.binary(max_size=8)), max_size=3)
"""Place, length, and replacement of bytes of valid data; places are counted modulo its length."""


def mutated(data: bytes, cuts: list[tuple[int, int, bytes]]) -> bytes:
    changed = bytearray(data)
    for place, length, replacement in cuts:
        at = place % (len(changed) + 1)
        changed[at : at + length] = replacement
    return bytes(changed)


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
@given(cuts=CUTS)
def test_any_record_of_missed_phases_is_read_or_rejected_with_a_message(
    tmp_path_factory: pytest.TempPathFactory, cuts: list[tuple[int, int, bytes]]
) -> None:
    path = tmp_path_factory.mktemp("missed") / missed_phases.MISSED
    missed_phases.write(path, [Missed(3, "offers", 0, [1]), Missed(3, "move", 0, [1, 2])])
    path.write_bytes(mutated(path.read_bytes(), cuts))
    try:
        record = missed_phases.read(path, 3)
    except ScenarioError as error:
        assert str(error)
    else:
        assert all(robot < 3 for missed in record for robot in missed.robots)


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
@given(cuts=CUTS)
def test_any_changed_settings_of_a_robot_are_read_or_rejected_with_a_message(
    cuts: list[tuple[int, int, bytes]],
) -> None:
    try:
        read_settings(mutated(SETTINGS.encode(), cuts))
    except ProtocolError as error:
        assert str(error)
