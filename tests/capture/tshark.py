"""tshark with the dissector, installed in a separate home directory, and the fields that it shows of a capture."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from deploy.after.wireshark import install as wireshark

SPLIT = "|"


@dataclass(frozen=True)
class Tshark:
    """A tshark whose personal plugin folder has the dissector, and nothing else."""

    program: str
    home: Path

    def run(self, *arguments: str | Path) -> str:
        """Run it; an error of Lua fails the test."""
        done = subprocess.run(
            [self.program, *map(str, arguments)],
            env={**os.environ, "HOME": str(self.home)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert "lua" not in done.stderr.lower(), done.stderr
        assert done.returncode == 0, done.stderr
        return done.stdout

    def fields(
        self, file: Path, names: Sequence[str], only: str = "murmur || !murmur"
    ) -> list[list[list[str]]]:
        """All values of each field, for each packet that fits the filter; a Lua error fails the test."""
        wanted = [item for name in [*names, "_ws.expert.message"] for item in ("-e", name)]
        separators = ("-E", "separator=/t", "-E", f"aggregator={SPLIT}")
        out = self.run("-r", file, "-Y", only, "-T", "fields", *separators, *wanted)
        assert "Lua Error" not in out, next(line for line in out.splitlines() if "Lua Error" in line)
        rows = [line.split("\t")[:-1] for line in out.splitlines()]
        return [[cell.split(SPLIT) if cell else [] for cell in row] for row in rows]


def find(home: Path) -> Tshark:
    """The tshark of this machine; where there is none the test is skipped."""
    program = shutil.which("tshark")
    if program is None:
        pytest.skip("no tshark here: install it (Debian: apt-get install tshark) to test the dissector")
    wireshark.install(home / ".local" / "lib" / "wireshark" / "plugins")
    found = Tshark(program, home)
    version = re.search(r"(\d+)\.(\d+)", found.run("--version"))
    assert version is not None
    if os.geteuid() == 0 and (int(version[1]), int(version[2])) >= (4, 4):
        pytest.skip("as root, tshark from 4.4 on loads no Lua plug-ins: run these tests as another user")
    return found
