"""murmur capture: the same as in Wireshark, as a table, with filters whose totals add up."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from deploy.after.wireshark import install as wireshark
from deploy.commands.app import app
from deploy.run.exploration import explore
from deploy.run.result import Result
from deploy.scenario.scenario import parse
from netshaper.capture import VERDICTS
from netshaper.ledger import CAUSES, FRAMES
from protocol.packet_codec import decode
from protocol.packets import ALL_KINDS, LAYOUTS, Offer


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Result:
    settings = {
        "robots": 3,
        "bandwidth": 900,
        "range": "40%",
        "steps": 30,
        "map_encoding": "scans",
        "strategy": "meier",
    }
    scenario = parse({**settings, "bus": "memory"})
    return explore(scenario, out=tmp_path_factory.mktemp("runs") / "one")


def murmur(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, ["capture", *map(str, arguments)])
    assert result.exit_code == code, result.output
    return result.output


def as_json(*arguments: object) -> dict[str, Any]:
    shown: dict[str, Any] = json.loads(murmur(*arguments, "--json"))
    return shown


def test_the_totals_equal_those_of_the_run(run: Result) -> None:
    assert run.directory is not None
    shown = as_json(run.directory)
    without_total = [
        {k: n for k, n in run.summary[what].items() if k != "total"} for what in ("bytes", "packets")
    ]
    assert [shown["totals"]["bytes"], shown["totals"]["packets"]] == without_total
    ledger = run.records.ledger()
    for verdict, refused in shown["totals"]["refused"].items():
        assert refused["bytes"] == ledger["bytes"][ledger["cause"] == CAUSES.index(verdict)].sum()
    assert shown["torn"] == 0
    assert len(shown["frames"]) == shown["totals"]["frames"]


def test_every_captured_packet_is_shown_by_name_and_field(run: Result) -> None:
    for frame in as_json(run.directory)["frames"]:
        if frame["verdict"] == "carried":
            assert frame["kept"] == frame["bytes"]
        if frame["frame"] == "offer":
            assert set(frame["packets"][0]) == {"kind", "packet", "map", "block"}
        if frame["frame"] == "broadcast":
            assert frame["packets"][0]["packet"] == "Target"
            assert frame["receiver"] == -1


@pytest.mark.parametrize("kind", ["conn", "targ", "scan"])
def test_filters_leave_out_exactly_the_frames_that_do_not_match(run: Result, kind: str) -> None:
    frames = as_json(run.directory)["frames"]
    by_robot = as_json(run.directory, "--robot", 2)["frames"]
    assert by_robot == [f for f in frames if 2 in (f["sender"], f["receiver"], *f["receivers"])]
    assert as_json(run.directory, "--step", "3-7")["frames"] == [f for f in frames if 3 <= f["step"] <= 7]
    assert as_json(run.directory, "--step", 5)["frames"] == [f for f in frames if f["step"] == 5]
    assert as_json(run.directory, "--refused")["frames"] == [f for f in frames if f["verdict"] != "carried"]
    of_kind = as_json(run.directory, "--kind", kind)
    assert of_kind["frames"] == [f for f in frames if any(p["kind"] == kind for p in f["packets"])]
    assert list(of_kind["totals"]["bytes"]) == [kind]
    assert of_kind["totals"]["bytes"][kind] == run.summary["bytes"][kind]


def test_the_table_has_a_line_per_frame_and_totals(run: Result) -> None:
    assert run.directory is not None
    lines = murmur(run.directory).splitlines()
    assert lines[0].split()[3:] == ["from", "to", "map", "frame", "bytes", "packets", "verdict"]
    total = next(line for line in lines if line.split()[:1] == ["total"])
    assert total.split()[1:4:2] == [str(run.summary["packets"]["total"]), str(run.summary["bytes"]["total"])]
    assert any(line.endswith("cut by budget") for line in lines)
    assert murmur(run.directory / "radio.pcapng", "--step", 1) == murmur(run.directory, "--step", 1)
    with_packets = murmur(run.directory, "--step", 1, "--packets").splitlines()
    line = next(line.split() for line in with_packets if line.split()[:2] == ["conn", "Offer"])
    (offer,) = decode(bytes.fromhex("".join(line[2:4])))
    assert isinstance(offer, Offer)
    assert line[4:] == ["map", str(offer.map), "block", str(offer.block)]


def test_an_incomplete_capture_is_shown_with_a_note(run: Result, tmp_path: Path) -> None:
    assert run.directory is not None
    whole = (run.directory / "radio.pcapng").read_bytes()
    cut = tmp_path / "cut.pcapng"
    cut.write_bytes(whole[:-5])
    assert "an incomplete block" in murmur(cut).splitlines()[-1]
    assert as_json(cut)["frames"] == as_json(run.directory)["frames"][:-1]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((), "name a run directory"),
        (("nowhere",), "nowhere: No such file or directory"),
        ((__file__,), "not a pcapng file"),
        (("nowhere", "--kind", "foo"), f"kind = 'foo': there are {', '.join(ALL_KINDS)}"),
        (("nowhere", "--step", "1-x"), "step = '1-x': must be a step, as 12, or steps, as 10-20"),
    ],
)
def test_errors_state_the_mistake_and_the_correct_form(arguments: tuple[str, ...], text: str) -> None:
    assert text in murmur(*arguments, code=2)


def test_the_installed_dissector_replaces_only_an_older_version_of_itself(tmp_path: Path) -> None:
    folder = tmp_path / "plugins"
    target = wireshark.install(folder)
    assert target == folder / "murmur.lua"
    target.write_text("-- Murmur's radio for Wireshark, but an older one")
    wireshark.install(folder)
    assert target.read_text() == wireshark.dissector()
    target.write_text("-- the dissector of someone else's Murmur")
    with pytest.raises(ValueError, match="is not Murmur's"):
        wireshark.install(folder)
    assert "someone else" in target.read_text()


def test_the_dissector_has_the_names_and_layouts_of_the_program() -> None:
    program = wireshark.dissector()
    assert "@" not in program
    for layout in LAYOUTS:
        assert f'name = "{layout.packet}", kind = "{layout.kind}", code = "{layout.code}"' in program
    for names in (FRAMES, VERDICTS):
        assert ", ".join(f'[{number}] = "{name}"' for number, name in enumerate(names)) in program


def test_the_command_prints_where_the_dissector_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("PATH", "")
    target = tmp_path / ".local" / "lib" / "wireshark" / "plugins" / "murmur.lua"
    assert murmur("--install-dissector").strip() == f"installed: {target}"
    assert target.is_file()
