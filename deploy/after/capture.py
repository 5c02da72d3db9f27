"""`murmur capture`: the frames of ``radio.pcapng``, as a table with filters and totals."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path
from typing import Any

import msgspec

from deploy.record.run_directory import CAPTURE, SCENARIO, read_scenario
from netshaper import capture
from netshaper.capture import VERDICTS, Captured
from netshaper.ledger import EVERYONE, FRAMES, on_air
from netshaper.pcapng import CaptureError, Reader
from protocol import packet_codec
from protocol.errors import ProtocolError
from protocol.files import open_file
from protocol.packets import ALL_KINDS, AnyPacket, Fragment, Update

CARRIED = 0

_COLUMNS = "{:>6} {:>2} {:>5} {:>6} {:>6} {:>3}  {:<9} {:>8}  {:<38}  {}"
_TITLES = ("step", "rd", "conn", "from", "to", "map", "frame", "bytes", "packets", "verdict")


@dataclass(frozen=True)
class Filter:
    """Conditions on frames; a frame matches if it meets every condition that is not None."""

    robot: int | None = None
    """Sender, addressee or receiver of the frame."""
    kind: str | None = None
    """One of `ALL_KINDS`: the frame contains such a packet; other packets are not counted."""
    steps: tuple[int, int] | None = None
    """First and last step."""
    refused: bool = False
    """Only frames that were refused or lost."""

    def check(self, path: Path) -> None:
        """Raise ValueError for an unknown kind, or a robot that the scenario beside the capture does not have."""
        if self.kind not in (None, *ALL_KINDS):
            raise ValueError(f"kind = {self.kind!r}: there are {', '.join(ALL_KINDS)}")
        folder = path if path.is_dir() else path.parent
        if self.robot is not None and (folder / SCENARIO).is_file():
            robots = read_scenario(folder).robots
            if self.robot >= robots:
                raise ValueError(f"robot = {self.robot}: must be at most {robots - 1}")

    def takes(self, frame: Captured, kinds: Iterable[str]) -> bool:
        """Whether a frame with packets of these kinds matches."""
        return (
            (self.robot is None or self.robot in (frame.sender, frame.receiver, *frame.receivers))
            and (self.kind is None or self.kind in kinds)
            and (self.steps is None or self.steps[0] <= frame.step <= self.steps[1])
            and (not self.refused or frame.cause != CARRIED)
        )


@dataclass
class Totals:
    """Totals of the frames shown.

    `carried`: (packets, bytes) by kind, as in the summary of a run. `refused`: (frames, bytes) by verdict, because the
    capture stores only the beginning of these frames. `unreadable`: bytes of carried frames that are no packets.
    """

    frames: int = 0
    unreadable: int = 0
    carried: dict[str, tuple[int, int]] = field(default_factory=dict)
    refused: dict[str, tuple[int, int]] = field(default_factory=dict)

    def add(self, frame: Captured, counts: dict[str, tuple[int, int]]) -> None:
        """Add a frame, with the counts of its packets."""
        self.frames += 1
        if on_air(frame.cause):
            self.unreadable += len(frame.payload) - sum(size for _, size in count(frame.payload).values())
            for kind, (number, size) in counts.items():
                before = self.carried.get(kind, (0, 0))
                self.carried[kind] = (before[0] + number, before[1] + size)
        if frame.cause != CARRIED:
            frames, size = self.refused.get(frame.verdict, (0, 0))
            self.refused[frame.verdict] = (frames + 1, size + frame.size)

    def to_json(self) -> dict[str, Any]:
        """The totals as `murmur capture --json` prints them."""
        carried = {kind: self.carried[kind] for kind in ALL_KINDS if kind in self.carried}
        refused = {verdict: self.refused[verdict] for verdict in VERDICTS if verdict in self.refused}
        return {
            "frames": self.frames,
            "packets": {kind: number for kind, (number, _) in carried.items()},
            "bytes": {kind: size for kind, (_, size) in carried.items()},
            "refused": {verdict: {"frames": n, "bytes": size} for verdict, (n, size) in refused.items()},
        }


@contextmanager
def opened(path: Path) -> Iterator[Reader]:
    """Open the capture of a run directory, or a capture file; CaptureError if it cannot be read."""
    file = path / CAPTURE if path.is_dir() else path
    if not path.exists():
        raise CaptureError(f"{path}: No such file or directory; name the directory of a run, or a capture")
    if path.is_dir() and not file.exists():
        raise CaptureError(f"{path}: not a run directory: {CAPTURE} is missing")
    try:
        with open_file(file) as stream:
            yield Reader(stream)
    except OSError as error:
        raise CaptureError(f"{file}: {error.strerror}") from None
    except CaptureError as error:
        raise CaptureError(f"{file}: {error}") from None


def select(reader: Reader, wanted: Filter, totals: Totals) -> Iterator[Captured]:
    """Yield the frames of a capture that match, and count them."""
    for frame in capture.read(reader):
        counts = count(frame.payload)
        if wanted.takes(frame, counts):
            totals.add(frame, {k: n for k, n in counts.items() if wanted.kind in (None, k)})
            yield frame


def count(payload: bytes) -> dict[str, tuple[int, int]]:
    """Count (packets, bytes) by kind, up to the first incomplete or malformed packet."""
    counts: dict[str, tuple[int, int]] = {}
    for piece in _pieces(payload):
        kind = packet_codec.name(piece)
        number, size = counts.get(kind, (0, 0))
        counts[kind] = (number + 1, size + len(piece))
    return counts


def lines(path: Path, wanted: Filter, *, every_packet: bool) -> Iterator[str]:
    """Yield the table line by line: one per frame, its packets if requested, totals at the end."""
    totals = Totals()
    with opened(path) as reader:
        frames = _begun(select(reader, wanted, totals))
        yield _COLUMNS.format(*_TITLES)
        for frame in frames:
            yield _row(frame)
            if every_packet:
                for piece, packet in _decoded(frame.payload):
                    yield f"{'':42}{packet.name:<7}{_describe(piece, packet)}"
        yield from _total_lines(totals)
        if totals.unreadable:
            yield (
                f"{totals.unreadable} bytes of carried frames are not readable, and not in these totals: packets "
                f"are malformed, or another version of Murmur wrote the capture."
            )
        if reader.torn:
            yield f"The last {reader.torn} bytes are an incomplete block: the run was killed."


def json_lines(path: Path, wanted: Filter) -> Iterator[str]:
    """Yield one JSON object, one frame per line: ``{"frames": [...], "totals": {...}, "torn": bytes}``."""
    totals = Totals()
    with opened(path) as reader:
        frames = _begun(select(reader, wanted, totals))
        yield '{"frames": ['
        before = ""
        for frame in frames:
            if before:
                yield before + ","
            before = json.dumps(_to_json(frame))
        yield before
        yield f'], "totals": {json.dumps(totals.to_json())}, "torn": {reader.torn}}}'


def parse_steps(text: str) -> tuple[int, int]:
    """Parse ``12`` or ``10-20``."""
    first, dash, last = text.partition("-")
    try:
        steps = int(first), int(last if dash else first)
    except ValueError:
        raise ValueError(f"step = {text!r}: must be a step, as 12, or steps, as 10-20") from None
    if steps[0] > steps[1]:
        raise ValueError(f"step = {text!r}: the first step must not exceed the last, as in 10-20")
    return steps


def _begun(frames: Iterator[Captured]) -> Iterator[Captured]:
    """The same frames, the first already read: an invalid file is reported before anything is printed."""
    return chain(list(islice(frames, 1)), frames)


def _row(frame: Captured) -> str:
    counts = count(frame.payload)
    contents = [f"{number} {kind}" for kind, (number, _) in counts.items()]
    rest = frame.size - sum(size for _, size in counts.values())
    if rest:
        contents.append(f"{rest} bytes not {'kept' if frame.size > len(frame.payload) else 'readable'}")
    return _COLUMNS.format(
        frame.step,
        frame.round,
        _or_dash(frame.connection),
        _name(frame.sender),
        _name(frame.receiver),
        _or_dash(frame.map),
        FRAMES[frame.frame],
        frame.size,
        ", ".join(contents),
        frame.comment,
    )


def _total_lines(totals: Totals) -> Iterator[str]:
    yield ""
    yield f"{totals.frames} frames"
    numbers = totals.to_json()
    for kind, size in numbers["bytes"].items():
        yield f"  {kind:<9} {numbers['packets'][kind]:>9} packets {size:>11} bytes carried"
    if numbers["bytes"]:
        packet_sum, byte_sum = sum(numbers["packets"].values()), sum(numbers["bytes"].values())
        yield f"  {'total':<9} {packet_sum:>9} packets {byte_sum:>11} bytes carried"
    for verdict, refused in numbers["refused"].items():
        missed = "received" if on_air(VERDICTS.index(verdict)) else "carried"
        yield f"  {verdict:<9} {refused['frames']:>9} frames  {refused['bytes']:>11} bytes not {missed}"


def _to_json(frame: Captured) -> dict[str, Any]:
    decoded = [
        {"kind": packet.name, "packet": type(packet).__name__} | _fields(packet)
        for _, packet in _decoded(frame.payload)
    ]
    return {
        "step": frame.step,
        "round": frame.round,
        "connection": frame.connection,
        "sender": frame.sender,
        "receiver": frame.receiver,
        "map": frame.map,
        "frame": FRAMES[frame.frame],
        "part": frame.part,
        "verdict": frame.verdict,
        "comment": frame.comment,
        "receivers": frame.receivers,
        "bytes": frame.size,
        "kept": len(frame.payload),
        "packets": decoded,
    }


def _pieces(payload: bytes) -> Iterator[bytes]:
    """Split a frame into its packets, up to the first incomplete or malformed one."""
    offset = 0
    with suppress(ProtocolError):
        while offset < len(payload):
            end = offset + packet_codec.length(payload, offset)
            if end > len(payload):
                return
            yield payload[offset:end]
            offset = end


def _decoded(payload: bytes) -> Iterator[tuple[bytes, AnyPacket]]:
    """Decode the packets of a frame, each with its bytes, up to the first malformed packet."""
    with suppress(ProtocolError):
        for piece in _pieces(payload):
            for packet in packet_codec.decode(piece):
                yield piece, packet


def _fields(packet: AnyPacket) -> dict[str, Any]:
    values = msgspec.structs.asdict(packet)
    return values | {"data": packet.data.hex()} if isinstance(packet, Fragment | Update) else values


def _describe(piece: bytes, packet: AnyPacket) -> str:
    values = "  ".join(f"{name} {value}" for name, value in _fields(packet).items() if name != "data")
    return f"{type(packet).__name__:<9} {piece.hex(' '):<17}  {values}".rstrip()


def _name(robot: int) -> str:
    return "all" if robot == EVERYONE else f"r{robot}" if robot >= 0 else "none"


def _or_dash(number: int) -> str:
    return str(number) if number >= 0 else "-"
