"""Serial modems, played by pseudo-terminals: framing, ports that cannot be used, and a team at 200 B/s."""

from __future__ import annotations

import contextlib
import os
import select
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from agent.radios.cobs import LineReader, line
from agent.radios.options import LinkOptions
from agent.radios.serial_modem import SerialModem
from agent.radios.transport import MAX_PER_CALL, Transport, TransportError, wait
from protocol.nanoseconds import SECOND
from tests.agent.radios.air_team import AirTeam, assert_maps_agree, exchange_all
from tests.agent.radios.modems import LONGEST, RATE, Modems, Terminal
from tests.agent.radios.test_teams_on_the_air import TEAM
from tests.system.team import small_plan

PATIENCE_S = 5


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    made = Terminal()
    yield made
    os.close(made.side)


def arrived(modem: SerialModem) -> list[bytes]:
    """The next frames; the kernel passes bytes on a moment after they are written, perhaps in parts."""
    frames: list[bytes] = []
    while not frames:
        assert select.select([modem], [], [], PATIENCE_S)[0]
        frames = modem.receive()
    return frames


def read(terminal: Terminal, size: int) -> bytes:
    """The next `size` bytes that a robot has written."""
    data = b""
    while len(data) < size:
        assert select.select([terminal.side], [], [], PATIENCE_S)[0]
        data += terminal.read()
    return data


def test_frames_cross_a_terminal_whatever_bytes_they_hold(terminal: Terminal) -> None:
    modem = SerialModem(terminal.path, 57600, LONGEST)
    frames = [bytes(range(LONGEST)), b"\x03\x04\x11\x13\r\n\0\x7f\xff" * 20, b""]
    for frame in frames:
        os.write(terminal.side, line(frame))
        assert arrived(modem) == [frame]
        assert modem.send(frame)
        assert read(terminal, len(line(frame))) == line(frame)
    assert not modem.send(bytes(LONGEST + 1))
    modem.close()
    assert not modem.send(b"")
    assert modem.receive() == []


def test_a_damaged_line_is_counted_and_the_next_one_arrives(terminal: Terminal) -> None:
    modem = SerialModem(terminal.path, 9600, LONGEST)
    damaged = bytearray(line(b"damaged"))
    damaged[3] ^= 1
    os.write(terminal.side, bytes(damaged) + line(b"next"))
    assert arrived(modem) == [b"next"]
    assert modem.damaged == 1
    modem.close()


def test_a_flood_of_short_lines_is_received_in_parts(terminal: Terminal) -> None:
    modem = SerialModem(terminal.path, 9600, LONGEST)
    received, left = list[int](), line(b"") * 900
    while sum(received) < 900:
        if left:
            with contextlib.suppress(BlockingIOError):
                left = left[os.write(terminal.side, left) :]
        received.append(len(modem.receive()))
    assert max(received) <= MAX_PER_CALL
    modem.close()


def test_a_port_that_no_modem_reads_fills_up_without_stopping_the_robot(terminal: Terminal) -> None:
    modem = SerialModem(terminal.path, 9600, LONGEST)
    sent = 0
    while modem.send(b"x" * LONGEST):
        sent += 1
    assert sent > 3
    reader = LineReader(LONGEST)
    received = 0
    while received < sent and select.select([terminal.side], [], [], PATIENCE_S)[0]:
        received += len(reader.feed(terminal.read()))
        modem.receive()  # writes the rest of the last line
    assert (received, reader.damaged) == (sent, 0)
    assert modem.send(b"again")
    modem.close()


def test_ports_that_cannot_be_used_are_refused(terminal: Terminal, tmp_path: Path) -> None:
    with pytest.raises(TransportError, match="No such file"):
        SerialModem(tmp_path / "ttyUSB0", 9600, LONGEST)
    with pytest.raises(TransportError, match=r"null (byte|character)"):
        SerialModem(Path("ttyUSB0\0"), 9600, LONGEST)
    with pytest.raises(TransportError, match="baud = 1234"):
        SerialModem(terminal.path, 1234, LONGEST)
    (tmp_path / "file").touch()
    with pytest.raises(TransportError, match="no serial port"):
        SerialModem(tmp_path / "file", 9600, LONGEST)
    modem = SerialModem(terminal.path, 9600, LONGEST)
    with pytest.raises(TransportError, match="in use"):
        SerialModem(terminal.path, 9600, LONGEST)
    modem.close()
    SerialModem(terminal.path, 9600, LONGEST).close()


def test_a_modem_that_is_unplugged_and_plugged_in_again_continues(tmp_path: Path) -> None:
    first, second, port = Terminal(), Terminal(), tmp_path / "modem"
    port.symlink_to(first.path)
    modem = SerialModem(port, 9600, LONGEST)
    os.close(first.side)
    port.unlink()
    assert modem.receive() == []
    assert modem.fileno() == -1
    assert not modem.send(b"frame")
    wait(modem, 1000)
    port.symlink_to(second.path)
    assert modem.send(b"frame")
    assert read(second, len(line(b"frame"))) == line(b"frame")
    os.write(second.side, line(b"reply"))
    wait(modem, PATIENCE_S * SECOND)
    assert arrived(modem) == [b"reply"]
    modem.close()
    assert not modem.send(b"frame")
    os.close(second.side)


def test_two_robots_share_an_office_over_modems_of_200_bytes_per_second_that_lose_a_tenth(
    tmp_path: Path,
) -> None:
    modems = Modems(2, loss=0.1)

    def join(number: int) -> Transport:
        return LinkOptions(
            "serial",
            serial_port=str(modems.terminals[number].path),
            bytes_per_s=RATE // 2,
            frame_bytes=LONGEST,
        ).open_transport()

    options = LinkOptions("serial", serial_port="as above", bytes_per_s=RATE // 2, frame_bytes=LONGEST)
    team = AirTeam(small_plan(robots=2, **TEAM), options, join, tmp_path, modems.carry)
    team.explore(400)
    exchange_all(team, 200)
    assert_maps_agree(team)
    assert modems.lost > 0
    assert np.count_nonzero(team.robots[0].planning) > 2000
    modems.close()
