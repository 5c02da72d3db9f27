"""A process of murmur serve-ros2, on a free port of loopback."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

from protocol.ros2.node import Ros2Node


@dataclass
class Served:
    """The process, the robots that it has printed, and what it printed at its end."""

    printed: dict[str, Any]
    nodes: ExitStack = field(default_factory=ExitStack)
    output: str = ""
    errors: str = ""

    def node(self, name: str, namespace: str) -> Ros2Node:
        """Open a node, which is closed before the process ends."""
        printed = self.printed
        node = Ros2Node(
            name, namespace, printed["domain"], distro=printed["distro"], router=printed["router"]
        )
        return self.nodes.enter_context(node)


def free_address() -> str:
    """Return an address of loopback whose port is free."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@contextmanager
def serving(*arguments: str) -> Iterator[Served]:
    """Run the command with these arguments, of which one is --json; at the end, it must exit without an error."""
    command = [
        sys.executable,
        "-m",
        "deploy.commands.main",
        "serve-ros2",
        *arguments,
        "--listen",
        free_address(),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            served = Served(json.loads(process.stdout.readline()))
            with served.nodes:
                yield served
        finally:
            process.send_signal(signal.SIGINT)
            output, errors = process.communicate(timeout=30)
    assert process.returncode == 0, errors
    served.output, served.errors = output, errors
