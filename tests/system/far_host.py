"""Another host, for tests: a network namespace with an SSH server in it, behind a link that delays and loses.

The link is two TUN devices, one in a namespace for each end, and a process between them that carries IP packets from
one to the other: each later by the delay, some not at all, and only so many bytes per second. So it is the kernel's own
TCP that meets delay and loss, also where the kernel has no netem.
"""

from __future__ import annotations

import contextlib
import fcntl
import heapq
import itertools
import math
import os
import random
import select
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
SSHD = "/usr/sbin/sshd"
NEAR, FAR = "10.213.77.1", "10.213.77.2"
NEAR_6, FAR_6 = "fd00:213:77::1", "fd00:213:77::2"
PORT = 2222
TOOLS = ("ip", "ssh", "ssh-keygen", SSHD)

_TUNSETIFF = 0x400454CA
_IFF_TUN, _IFF_NO_PI = 0x0001, 0x1000
_MTU = 1500
_NUMBERS = itertools.count()
"""Numbers of the far hosts of this process, several of which may exist at a time."""
QUEUE_S = 2.0
"""Longest time for which a packet waits for those before it."""


def why_not() -> str:
    """Why there can be no other host here; empty if there can."""
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        return f"not installed: {', '.join(missing)}"
    if os.geteuid() != 0:
        return "network namespaces need root"
    name = f"murmur-try-{os.getpid()}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, check=False)
    if made.returncode:
        return f"no network namespaces: {made.stderr.decode().strip()}"
    subprocess.run(["ip", "netns", "del", name], check=False)
    try:
        os.close(_tun(f"mmtry{os.getpid() % 100000}"))
    except OSError as error:
        return f"no TUN devices: {error}"
    return ""


@dataclass(frozen=True)
class FarHost:
    """Two namespaces: `near` for the launcher, `far` with the SSH server."""

    near: str
    far: str
    folder: Path

    def command(self, *words: str) -> list[str]:
        """A command line that runs in the near namespace."""
        return ["ip", "netns", "exec", self.near, *words]

    def hosts(self, address: str = NEAR, **changes: str) -> str:
        """A hosts file with an address of this host; `changes` are TOML values of the other host's settings."""
        python = f"{sys.executable} -m deploy.commands.main"
        known = self.folder / "known_hosts"
        settings = {
            "name": '"far"',
            "ssh": f'"{FAR}"',
            "port": str(PORT),
            "options": f'["IdentityFile={self.folder}/id", "UserKnownHostsFile={known}"]',
            "command": f'"cd {self.folder} && env PYTHONPATH={ROOT} {python}"',
            "robots": "1",
        } | changes
        lines = [f"{key} = {value}" for key, value in settings.items()]
        return "\n".join([f'address = "{address}"', "[[host]]", *lines]) + "\n"

    @contextlib.contextmanager
    def vanished(self) -> Iterator[None]:
        """Within the context, nothing that the far host sends arrives."""
        route = "blackhole", f"{NEAR}/32"
        _ip("-n", self.far, "route", "add", *route)
        try:
            yield
        finally:
            _ip("-n", self.far, "route", "del", *route)

    def processes(self) -> list[int]:
        """What runs in the far namespace, other than the SSH server."""
        found = subprocess.run(["ip", "netns", "pids", self.far], capture_output=True, text=True, check=True)
        pids = [int(line) for line in found.stdout.split()]
        return [pid for pid in pids if not _title(pid).startswith((SSHD, "sshd"))]


@contextlib.contextmanager
def far_host(
    folder: Path, round_trip_ms: float = 0.0, loss: float = 0.0, bytes_per_s: float = math.inf
) -> Iterator[FarHost]:
    """Make another host; `loss` is the share of packets that get lost, each way, and `bytes_per_s` holds each way."""
    with contextlib.ExitStack() as stack:
        unique = f"{os.getpid() % 1000000}-{next(_NUMBERS)}"
        host = FarHost(f"murmur-near-{unique}", f"murmur-far-{unique}", folder)
        ends = []
        for number, (name, address, six) in enumerate(((host.near, NEAR, NEAR_6), (host.far, FAR, FAR_6))):
            _ip("netns", "add", name)
            stack.callback(_ip, "netns", "del", name)
            device = f"mm{number}t{unique}"
            ends.append(_tun(device))
            stack.callback(os.close, ends[-1])
            _ip("link", "set", device, "netns", name)
            for words in (
                ("link", "set", "lo", "up"),
                ("addr", "add", f"{address}/24", "dev", device),
                ("addr", "add", f"{six}/64", "dev", device, "nodad"),
                ("link", "set", device, "mtu", str(_MTU), "up"),
            ):
                _ip("-n", name, *words)
        stack.enter_context(_link(ends, round_trip_ms / 2000, loss, bytes_per_s))
        stack.enter_context(_ssh_server(host))
        yield host


def carry(ends: list[int], delay_s: float, loss: float, bytes_per_s: float) -> None:
    """Carry packets between two TUN devices until killed; drop those that would wait for `QUEUE_S`."""
    draw = random.Random(0)
    order = itertools.count()
    under_way: list[tuple[float, int, int, bytes]] = []
    is_free_at = dict.fromkeys(ends, 0.0)
    while True:
        wait = max(0.0, under_way[0][0] - time.monotonic()) if under_way else None
        for end in select.select(ends, [], [], wait)[0]:
            packet = os.read(end, 1 << 16)
            other = ends[1] if end == ends[0] else ends[0]
            now = time.monotonic()
            begins = max(now, is_free_at[other])
            if draw.random() >= loss and begins < now + QUEUE_S:
                is_free_at[other] = begins + len(packet) / bytes_per_s
                heapq.heappush(under_way, (is_free_at[other] + delay_s, next(order), other, packet))
        while under_way and under_way[0][0] <= time.monotonic():
            *_, end, packet = heapq.heappop(under_way)
            with contextlib.suppress(OSError):  # the end is gone
                os.write(end, packet)


@contextlib.contextmanager
def _link(ends: list[int], delay_s: float, loss: float, bytes_per_s: float) -> Iterator[None]:
    script = (
        f"from tests.system.far_host import carry; carry({ends}, {delay_s}, {loss}, float('{bytes_per_s}'))"
    )
    process = subprocess.Popen([sys.executable, "-c", script], cwd=ROOT, pass_fds=ends)
    try:
        yield
    finally:
        process.kill()
        process.wait()


@contextlib.contextmanager
def _ssh_server(host: FarHost) -> Iterator[None]:
    """An SSH server with its own keys, which accepts the key beside them."""
    folder = host.folder
    for name in ("id", "host_key"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / name], check=True)
    public = (folder / "host_key.pub").read_text()
    (folder / "known_hosts").write_text(f"[{FAR}]:{PORT} {public}")
    settings = {
        "ListenAddress": f"{FAR}:{PORT}",
        "HostKey": folder / "host_key",
        "AuthorizedKeysFile": folder / "id.pub",
        "PidFile": "none",
        "StrictModes": "no",
        "UsePAM": "no",
        "UseDNS": "no",
        "PasswordAuthentication": "no",
        "KbdInteractiveAuthentication": "no",
        "PermitRootLogin": "prohibit-password",
    }
    (folder / "sshd_config").write_text("".join(f"{key} {value}\n" for key, value in settings.items()))
    Path("/run/sshd").mkdir(exist_ok=True)
    command = ["ip", "netns", "exec", host.far, SSHD, "-D", "-e", "-f", str(folder / "sshd_config")]
    with (folder / "sshd.log").open("wb") as log:
        server = subprocess.Popen(command, stderr=log)
    try:
        deadline = time.monotonic() + 20
        while "Server listening" not in (folder / "sshd.log").read_text():
            assert server.poll() is None and time.monotonic() < deadline, (folder / "sshd.log").read_text()
            time.sleep(0.02)
        yield
    finally:
        found = subprocess.run(["ip", "netns", "pids", host.far], capture_output=True, text=True, check=False)
        for pid in found.stdout.split():
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(pid), signal.SIGKILL)
        server.wait()


def _tun(name: str) -> int:
    """Open a new TUN device of this namespace; it lasts as long as what is returned is open."""
    device = os.open("/dev/net/tun", os.O_RDWR)
    try:
        fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _IFF_TUN | _IFF_NO_PI))
    except OSError:
        os.close(device)
        raise
    return device


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True)


def _title(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        return "sshd: gone"
