"""Reject the project's retired vocabulary: ``python tests/retired_words.py``, part of ``make check``.

docs/glossary.md has the terms that replaced these words. CHANGELOG.md, which lists old and new names, is exempt.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]

RETIRED = {
    r"hearsay": "relayed state",
    r"crumbs?": "small frontier",
    r"vantages?": "viewpoint",
    r"nonsense|babbles?|babbling": "protocol error, malformed message",
    r"minds?": "robot settings, control logic",
    r"one's( own)?|oneself": "this robot's, the sender's",
    r"somebody|nobody|anybody": "a robot, a peer, no robot",
    r"so-manieth": "state the fraction",
    r"last words": "crash report, last output",
    r"liars?": "byzantine robot",
    r"laboratory": "recorder",
    r"exchange (polygon|laser|grid|sight)|(polygon|laser|grid|sight) exchange": "map encoding",
    r"surprises?|surprising": "prediction errors",
    r"\w*metres?": "meters",
    r"(was|were|is|are|been) (told|said|heard)": "sent, received, queued",
}
"""Retired words, as regular expressions without regard to case, and their replacements."""

SUFFIXES = {".py", ".md", ".toml", ".jinja", ".lua", ".yml"}
EXEMPT = {"CHANGELOG.md", "tests/retired_words.py"}
QUOTED = "on the air, but nobody was in range"
"""A text that captures contain: captures of earlier versions stay byte for byte the same."""

PATTERN = re.compile("|".join(rf"(?P<w{n}>\b(?:{word})\b)" for n, word in enumerate(RETIRED)), re.IGNORECASE)


def main() -> int:
    """Print each use of a retired word with its replacement; return 1 if there is any."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True)
    found = 0
    for name in listed.stdout.splitlines():
        path = ROOT / name
        if path.suffix not in SUFFIXES or name in EXEMPT or not path.exists():
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            for match in PATTERN.finditer(line.replace(QUOTED, "")):
                group = match.lastgroup or ""
                instead = list(RETIRED.values())[int(group[1:])]
                print(f"{name}:{number}: {match.group()!r} is retired; use: {instead}")
                found += 1
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
