"""Run a swarm while a raw socket captures all packets of the loopback: ``watched_swarm.py DIR SCENARIO``.

The scenario is JSON. Where it may, it does so in a network namespace of its own, in which nothing else
speaks. It leaves in DIR the run directory ``run``, ``packets.bin`` (each frame behind its length), and
``table.json``: which processes there were, their sockets and pipes in the middle of the run, and how many
packets were missed.
"""

from __future__ import annotations

import ctypes
import fcntl
import json
import multiprocessing
import os
import socket
import struct
import sys
from pathlib import Path
from typing import Any

from sniffer import Sniffer

from deploy.record.records import Records
from deploy.run.exploration import explore
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import parse

CLONE_NEWNET = 0x40000000
SIOCSIFFLAGS, IFF_UP, IFF_RUNNING = 0x8914, 0x1, 0x40


def leave_the_network() -> bool:
    """Move into a new network namespace that has only a loopback; return whether the system allowed it."""
    if ctypes.CDLL(None, use_errno=True).unshare(CLONE_NEWNET) != 0:
        return False
    with socket.socket() as any_socket:
        request = struct.pack("16sH14x", b"lo", IFF_UP | IFF_RUNNING)
        fcntl.ioctl(any_socket, SIOCSIFFLAGS, request)
    return True


def channels(pid: int) -> dict[str, Any]:
    """The sockets and pipe ends of a process: TCP as [local port, remote port], pipes as [number, mode]."""
    tcp = {}
    for line in Path(f"/proc/{pid}/net/tcp").read_text().splitlines()[1:]:
        fields = line.split()
        tcp[fields[9]] = [int(fields[1][-4:], 16), int(fields[2][-4:], 16)]
    found: dict[str, Any] = {"tcp": [], "other sockets": [], "pipes": []}
    for entry in list(Path(f"/proc/{pid}/fd").iterdir()):
        try:
            kind, _, name = str(entry.readlink()).partition(":")
            info = Path(f"/proc/{pid}/fdinfo/{entry.name}").read_text()
        except FileNotFoundError:
            continue  # the descriptor of the directory listing itself
        inode = name.strip("[]")
        if kind == "socket":
            found["tcp" if inode in tcp else "other sockets"].append(tcp.get(inode, inode))
        elif kind == "pipe":
            flags = next(line.split()[1] for line in info.splitlines() if line.startswith("flags:"))
            found["pipes"].append([inode, int(flags, 8) & os.O_ACCMODE])
    return found


def main(folder: Path, settings: dict[str, Any]) -> None:
    alone = leave_the_network()
    processes: dict[str, Any] = {}

    def look(_plan: Plan, records: Records) -> None:
        if records.world and not processes:
            for child in multiprocessing.active_children():
                assert child.pid is not None
                processes[child.name] = channels(child.pid)
            processes["recorder"] = channels(os.getpid())

    with Sniffer() as sniffer:
        result = explore(parse(settings), out=folder / "run", watch=look)
    assert not result.deaths, result.deaths
    table = {"alone": alone, "dropped": sniffer.dropped, "processes": processes}
    (folder / "table.json").write_text(json.dumps(table))
    with (folder / "packets.bin").open("wb") as file:
        for packet in sniffer.packets:
            file.write(len(packet).to_bytes(4, "little") + packet)


if __name__ == "__main__":
    main(Path(sys.argv[1]), json.loads(sys.argv[2]))
