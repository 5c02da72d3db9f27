"""Compare layouts, limits, tables, defaults and hex in the documentation with the code."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from msgspec.structs import replace

from agent.encodings.catalog import ENCODINGS
from agent.encodings.predictive import PredictiveEncoding
from agent.outline.approximation import approximation, repair
from agent.outline.contour import contours
from agent.outline.edits import NumberedPolygons
from agent.outline.receiver import Receiver
from agent.outline.simplify import refine
from agent.predictive.scan_updates import MAX_SCANS
from agent.predictive.tile_author import ENOUGH_TILES, INTERVAL, LONGEST_WAIT, QUIET_STEPS
from agent.predictive.urgent_tile_author import FEW_QUIET_STEPS
from agent.replication import handshakes, neighbors
from agent.replication.base import Replication
from agent.replication.engine import DISSEMINATIONS
from agent.settings import EncodingSettings, ReplicationSettings, Settings
from deploy.record.columns import SUMMARY
from deploy.run.exploration import explore
from deploy.run.in_memory import MemoryRun
from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import make
from deploy.scenario.scenario import SHIPPED, Scenario, load
from docs import code_tables, made_pages, packet_tables
from netshaper import access
from netshaper.ledger import CAUSES
from protocol import messages, packet_codec, packet_index, packets
from protocol.body import Body
from protocol.grid import MAX_ROBOTS, MAX_SIDE, UNKNOWN, Grid, ray_table
from protocol.keys import Keys
from protocol.messages import Delivery, RoundReport, SendReport
from protocol.scans import Scan, draw, encode_scan, fragments
from tests.agent.outline.edit_scripts import canonical, edit_script
from tests.agent.replication.network import make_engine
from worldsim import generators
from worldsim.laser import cast
from worldsim.maps import MapError

DOCS = Path(__file__).parents[2] / "docs"
GOLDEN = Path(__file__).parents[1] / "protocol" / "golden"

ROOM = """
    ######     ######     ######
    #....#     #....#     #....#
    #.??.#     #.?..#     #....#
    #....#     #....#     #....#
    ######     ######     ######
"""
"""The map of the worked example's robot after each of its three steps."""


def fences(document: str) -> dict[str, str]:
    """Return the fenced blocks of a document by their language; the last one of each."""
    text = (DOCS / document).read_text(encoding="utf-8")
    return dict(re.findall(r"^```(\S+)\n(.*?)^```$", text, re.M | re.S))


def rows(document: str, heading: str) -> list[list[str]]:
    """The cells of the first table below a heading, its head left out, code marks taken off."""
    text = (DOCS / document).read_text(encoding="utf-8").split(f"\n## {heading}\n")[1]
    table: list[list[str]] = []
    for line in map(str.strip, text.splitlines()):
        if line.startswith("|"):
            table.append([cell.strip() for cell in line.strip("|").split("|")])
        elif table:
            break
    return [[cell.replace("`", "") for cell in row] for row in table[2:]]


def knowledge() -> Iterator[Grid]:
    lines = [line.split() for line in ROOM.split("\n") if line.strip()]
    for column in zip(*lines, strict=True):
        yield np.array([["?.#".index(cell) for cell in line] for line in column], np.uint8)


def scripts() -> Iterator[tuple[list[packets.Edit], NumberedPolygons]]:
    """Yield the edit scripts of the worked example, each with the polygons after it."""
    held = NumberedPolygons.empty((5, 6))
    for grid in knowledge():
        exact = contours(grid, (1, 1))
        marks = refine(exact, repair(held.polygons, exact))
        edits, held = edit_script(held, approximation(exact, marks))
        yield edits, held


def described(*buffers: bytes) -> list[str]:
    return [
        f"{piece.hex(' '):18} {packet_codec.decode(piece)[0]!r}"
        for buffer in buffers
        for piece in packet_index.split(buffer)
    ]


def replication(robot: int, robots: int, dissemination: str = "backoff") -> Replication:
    return make_engine(robot, robots, lambda *received: packet_index.ends(received[-1]), dissemination)


def worked_example() -> str:
    """An object that emerges, is changed, and is removed; three save points; then how they travel."""
    lines = []
    entries: list[bytes] = []
    for step, (edits, _) in enumerate(scripts(), 1):
        lines += [f"# step {step}", *described(packet_codec.encode(edits))]
        entries += [packet_codec.encode([packet]) for packet in edits]
    sender, receiver = replication(0, 2), replication(1, 2)
    sender.own_log.append(entries)
    (offer,) = sender.open_round(0, [1], None)
    receiver.open_round(0, [0], None)
    (answer,) = receiver.answer([Delivery(0, offer.payload, 0)])
    (data,) = sender.send_data([Delivery(1, answer.payload, 0, 0)])
    assert data.payload == b"".join(entries)
    lines += ["# robot 0 to robot 1: news of map 0", *described(offer.payload)]
    lines += ["# robot 1 to robot 0: no entry yet", *described(answer.payload)]
    lines += [f"# robot 0 to robot 1: the {len(entries)} packets above, {len(data.payload)} bytes"]
    return "\n".join(lines) + "\n"


def block_example() -> str:
    """A receiver that holds more than the sender expects, and one that two robots offer the same map."""
    sender, receiver = replication(0, 3), replication(1, 3)
    sender.logs[2].append(5000 * [packet_codec.encode([packets.Save()])])
    receiver.logs[2].append(4200 * [packet_codec.encode([packets.Save()])])
    sender.open_round(0, [1], None)
    (offer,) = sender.open_round(1, [1], None)
    answer, decline = receiver.answer([Delivery(0, offer.payload, 0), Delivery(2, offer.payload, 1)])
    (data,) = sender.send_data([Delivery(1, answer.payload, 0, 2)])
    lines = [
        "# robot 0 to robot 1: news of map 2, of which robot 1 probably holds nothing",
        *described(offer.payload),
    ]
    lines += ["# robot 1 to robot 0: it holds 1 x 4096 + 104 entries", *described(answer.payload)]
    lines += [f"# robot 0 to robot 1: entries 4200 to 4999, {len(data.payload)} bytes"]
    lines += ["# robot 1 to another that offers map 2 in the same round", *described(decline.payload)]
    return "\n".join(lines) + "\n"


HALL = """
    ############
    #....#.....#
    #..........#
    #....#.....#
    ############
"""
"""The world of the worked example of map updates."""


def updates_example() -> str:
    """Three scans of a robot that drives through a hall, as map updates by gossip."""
    rows = [line.strip() for line in HALL.split("\n") if line.strip()]
    truth = np.array([["?.#".index(cell) for cell in row] for row in rows], np.uint8)
    height, width = truth.shape
    settings = Settings(
        robot=0, bodies=(Body(5.0, 360.0, 3.0),) * 3, width=width, height=height, beams=72, seed=0,
        strategy="meier", encoding=EncodingSettings("predictive"), replication=ReplicationSettings("gossip"),
    )  # fmt: skip
    maker, gossip, receiver = (
        PredictiveEncoding(settings),
        replication(0, 3, "gossip"),
        PredictiveEncoding(replace(settings, robot=1)),
    )
    own, no_robots, beams = (
        np.full(truth.shape, UNKNOWN, np.uint8),
        np.zeros(truth.shape, np.bool_),
        ray_table(5.0, 72),
    )
    lines = []
    for x, peers in ((1, [1]), (3, [1]), (6, [1, 2])):
        readings = cast(truth, no_robots, beams, x, 2)
        change = draw(own, beams, x, 2, readings)
        entries = maker.encode_changes(own, Scan(x, 2, readings), change, delivered=True)
        gossip.own_log.append(entries)
        frame = gossip.open_round(0, peers, None)[0].payload
        assert not gossip.close_round(RoundReport(1, 0, [], [SendReport(0, len(frame))], [], False))
        receiver.apply(0, b"".join(entries), step=1000, sender=0)
        assert (receiver.merge(np.zeros_like(own)) == own).all()
        known = int((own != UNKNOWN).sum())
        lines += [
            f"# robot 0 in cell ({x}, 2), in range {peers}: {change.cells} new cells, {known} known",
            *described(frame),
        ]
    return "\n".join(lines) + "\n"


def test_packet_layouts_and_fields_are_those_of_the_code() -> None:
    page = (DOCS / "protocol.md").read_text(encoding="utf-8")
    drawings = [layout.drawing() for layout in packets.LAYOUTS]
    assert fences("protocol.md")["packets"].splitlines() == drawings
    assert packet_tables.updated(page) == page, "run python -m docs.packet_tables"
    for layout in packets.LAYOUTS:
        for name, bits in layout.fields:
            row = rf"^\| `{bits.letter}` \| {name} \| {bits.width} \| [^|]*`{layout.packet}`"
            assert re.search(row, packet_tables.fields(), re.M)


def test_limits_are_those_of_the_code() -> None:
    limits = {name: value for name, value, *_ in rows("protocol.md", "Limits")}
    assert limits == {
        "cells per side of the grid": str(MAX_SIDE),
        "robots": str(MAX_ROBOTS),
        "maps with handshakes": str(packets.MAX_MAPS),
        "maps with gossip": str(packets.MAX_GOSSIP_MAPS),
        "objects per approximation": str(packets.MAX_OBJECTS),
        "vertices per object": str(packets.MAX_VERTICES),
        "log entries per block": str(packets.INDEX_WINDOW),
        "blocks per cycle": str(packets.BLOCKS),
        "cycles": str(packets.BLOCKS),
        "bytes of a fragment's content": str(packets.FRAGMENT_DATA),
        "scans per log entry": str(MAX_SCANS),
        "log offsets with gossip": str(packets.GOSSIP_WINDOW),
    }


def test_a_scan_takes_the_documented_bytes() -> None:
    scan = encode_scan(Scan(0, 0, np.zeros(360, np.uint16)))
    on_air = fragments(scan)
    text = (DOCS / "protocol.md").read_text(encoding="utf-8")
    assert (
        f"A scan of 360 beams is {len(scan)} bytes, {len(on_air)} fragments, {sum(map(len, on_air))} bytes "
        "on the air." in text
    )


@pytest.mark.parametrize(
    ("fence", "made"),
    [("example", worked_example()), ("blocks", block_example()), ("updates", updates_example())],
    ids=["example", "blocks", "updates"],
)
def test_the_worked_example_equals_the_code_s_result_to_the_byte(fence: str, made: str) -> None:
    assert fences("protocol.md")[fence] == made
    assert (GOLDEN / f"{fence}.txt").read_text(encoding="utf-8") == made


def test_the_hex_in_the_document_decodes_as_explained_there() -> None:
    block = fences("protocol.md")["example"]
    receiver = Receiver((5, 6))
    models = [canonical(held.polygons) for _, held in scripts()]
    for line in block.splitlines():
        if line.startswith("#"):
            continue
        code, explained = line[:18], line[19:]
        (packet,) = packet_codec.decode(bytes.fromhex(code))
        assert repr(packet) == explained
        if not isinstance(packet, packets.Offer | packets.Answer) and receiver.feed(bytes.fromhex(code)):
            assert canonical(receiver.held.polygons) == models.pop(0)
    assert not models


def test_the_rooms_of_the_worked_example_are_drawn() -> None:
    text = (DOCS / "protocol.md").read_text(encoding="utf-8")
    assert ROOM.strip("\n") in text
    assert HALL.strip("\n") in text


def test_the_transition_tables_are_those_by_which_the_code_runs() -> None:
    connections = {
        (state, event, after) for _, state, event, after, _ in rows("replication.md", "Handshakes")
    }
    assert connections == {(*before, after) for before, after in handshakes.TRANSITIONS.items()}
    facts = {True: "yes", False: "no", None: ""}
    events = {
        event: tuple(facts[fact] for fact in changed) for event, changed in neighbors.TRANSITIONS.items()
    }
    assert {event: (owes, awaits) for event, owes, awaits in rows("replication.md", "Meetings")} == events


def test_disseminations_are_all_described() -> None:
    assert {row[0] for row in rows("replication.md", "Disseminations")} == set(DISSEMINATIONS)


def test_messages_are_numbered_and_on_the_generated_page_in_order() -> None:
    kinds = messages.TYPES
    page = made_pages.messages_page()
    assert [kind.__struct_config__.tag for kind in kinds] == list(range(len(kinds)))
    assert set(messages.Record.__subclasses__()) == set(kinds)
    listed = re.findall(r"^\| (\d+) \| `(\w+)` \| (.*?) \| \w", page, re.M)
    assert listed == [
        (str(n), kind.__name__, ", ".join(kind.__struct_fields__)) for n, kind in enumerate(kinds)
    ]


def test_the_document_lists_all_causes_of_the_ledger() -> None:
    assert [row[0] for row in rows("protocol.md", "The ledger")] == list(CAUSES[1:])


def test_tables_of_settings_and_presets_are_those_of_the_code() -> None:
    for page, text in code_tables.pages().items():
        assert page.read_text(encoding="utf-8") == text, "run python -m docs.code_tables"
    for choice in (*ENCODINGS, *get_args(Scenario.model_fields["bus"].annotation)):
        assert f"`{choice}`" in (DOCS / "settings.md").read_text(encoding="utf-8")


def test_the_documented_keys_and_participants_are_those_of_the_code() -> None:
    keys = Keys("RUN")
    there_are = {row[0] for row in rows("bus.md", "Keys")}
    assert there_are == {
        keys.radio_tx("FROM"),
        keys.radio_rx("TO", "FROM"),
        keys.body("TO", "FROM"),
        keys.control("TO", "FROM"),
        keys.control_tx("FROM"),
        keys.alive("NAME"),
        keys.presence("NAME"),
    }
    names = {row[0] for row in rows("bus.md", "Participants")}
    assert names == {"relay", *access.participants(0), "r0, r1, ..."}


@pytest.mark.parametrize("name", made_pages.REFERENCE)
def test_reference_pages_are_those_of_the_code(name: str) -> None:
    page = (DOCS / "reference" / name).read_text(encoding="utf-8")
    assert page == made_pages.REFERENCE[name](), "run python -m docs.made_pages"


@pytest.mark.parametrize("document", sorted(DOCS.rglob("*.md")), ids=lambda path: str(path.relative_to(DOCS)))
def test_links_between_documents_lead_somewhere(document: Path) -> None:
    for target in re.findall(r"\]\((?!https?://)([^)#]+)\)", document.read_text(encoding="utf-8")):
        assert (document.parent / target).exists(), f"{document.name} links to {target}"


@pytest.mark.parametrize(
    "document",
    ["architecture.md", "bus.md", "contributing.md", "protocol.md", "radios.md", "several-terminals.md"],
)
def test_files_that_documents_name_are_there(document: str) -> None:
    text = (DOCS / document).read_text(encoding="utf-8")
    rooms = "agent|deploy|netshaper|protocol|tests|worldsim"
    named = re.findall(rf"`((?:{rooms})/[\w/.-]*\w/?)`", text)
    assert named
    for path in named:
        assert (DOCS.parent / path).exists(), f"{document} names {path}"


def test_the_reading_order_names_every_package_and_modules_that_exist() -> None:
    order = {
        package: re.findall(r"\w+", modules) for package, _, modules in rows("architecture.md", "Packages")
    }
    missing = [
        f"{package}{module}.py"
        for package, modules in order.items()
        for module in modules
        if not (DOCS.parent / package / f"{module}.py").exists()
    ]
    assert not missing
    packages = {
        f"{path.parent.relative_to(DOCS.parent)}/"
        for name in ("agent", "deploy", "murmur", "netshaper", "protocol", "worldsim")
        for path in (DOCS.parent / name).rglob("__init__.py")
    }
    assert packages - {"deploy/", "deploy/after/wireshark/", "worldsim/generators/"} <= set(order)


SCENARIOS = sorted(path.name for path in SHIPPED.glob("*.toml"))


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_shipped_scenario_contains_the_command_that_runs_it(name: str) -> None:
    scenario = load(Path(name), {})
    make(scenario)
    comment = (SHIPPED / name).read_text(encoding="utf-8")
    assert f"murmur explore {name}\n" in comment


@pytest.mark.parametrize("name", ["breakdown.toml", "mixed-team.toml"])
def test_a_shipped_scenario_runs(name: str) -> None:
    records = MemoryRun(make(load(Path(name), {"steps": 70}))).complete()
    assert records.end is not None
    assert records.end.step == 70
    assert not records.lost
    assert not records.protocol_errors.texts
    alive = {len(np.frombuffer(report.poses, "<i4")) // 4 for report in records.world}
    assert alive == ({4, 3} if name == "breakdown.toml" else {4})


def test_a_local_file_has_precedence_over_a_shipped_scenario(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert load(Path("office.toml"), {}).robots == 5
    Path("office.toml").write_text("robots = 2\n")
    assert load(Path("office.toml"), {}).robots == 2
    with pytest.raises(ScenarioError, match=r"no such file, .*; did you mean office.toml.*kilobyte\.toml"):
        load(Path("elsewhere") / "office.toml", {})


def test_the_documented_run_directory_is_that_of_a_run(tmp_path: Path) -> None:
    out = tmp_path / "run"
    explore(load(None, {"map": "em", "robots": 2, "bus": "memory", "steps": 5}), out=out)
    listed = names("The run directory")
    left = {re.sub(r"r\d+", "rN", path.name) for path in out.iterdir()}
    assert left <= listed
    assert {"summary.json", "scenario.toml", "ledger.parquet"} <= left
    assert set(json.loads((out / "summary.json").read_text())) == set(", ".join(SUMMARY).split(", "))


def names(heading: str) -> set[str]:
    """Names in the first column of a table of the architecture; a cell may have several."""
    return {name for row in rows("architecture.md", heading) for name in row[0].split(", ")}


def test_every_purpose_of_a_random_draw_is_named() -> None:
    table = {row[0] for row in rows("architecture.md", "Why runs repeat")}
    drawn_for: set[str] = set()
    for room in ("agent", "netshaper", "worldsim"):
        for path in (DOCS.parent / room).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            drawn_for.update(re.findall(r'\b(?:keyed_random\([^"()]*|_?drawn?\()"([^"]+)"', text))
    assert table == drawn_for


def test_the_page_of_the_predictive_encoding_tells_when_tiles_are_sent() -> None:
    text = " ".join((DOCS / "predictive.md").read_text(encoding="utf-8").split())
    for rule in (
        f"have not changed for {QUIET_STEPS} steps",
        f"when it has waited for {LONGEST_WAIT} steps",
        f"when {ENOUGH_TILES} ready tiles violate it",
        f"at least {INTERVAL} steps must have passed",
        f"has not changed for {FEW_QUIET_STEPS} steps",
    ):
        assert rule in text


def test_the_table_of_generated_maps_has_their_sizes_limits_and_clutter() -> None:
    text = (DOCS / "maps.md").read_text(encoding="utf-8")
    table = text[text.index("| generator |") :].partition("\n\n")[0].splitlines()[2:]
    for line in table:
        name, _, size, shortest, clutter, objects = (cell.strip(" `") for cell in line.strip("|").split("|"))
        width, height = map(float, size.split(" x "))
        world = generators.make(name)
        assert (world.width, world.height) == (round(width * 10), round(height * 10))
        least = {"width_m": float(shortest), "height_m": float(shortest)}
        generators.make(name, **least)
        with pytest.raises(MapError, match=f"at least {shortest} m"):
            generators.make(name, **least | {"width_m": float(shortest) - 0.2})
        assert np.array_equal(generators.make(name, clutter=float(clutter)).cells, world.cells)
        with pytest.raises(MapError, match=f"0 to 20 .*{objects} per 100"):
            generators.make(name, clutter=20.5)
