"""The packet layouts in docs/protocol.md, and the table of their fields on a page of the site.

Run ``python -m docs.packet_tables`` after a change of a packet; `tests/deploy/test_docs.py` compares page and code.
"""

from __future__ import annotations

import re
from pathlib import Path

from protocol.packets import LAYOUTS

PAGE = Path(__file__).with_name("protocol.md")
HEAD = "| letter | field | bits | packets | value |\n|---|---|---|---|---|\n"


def layouts() -> str:
    """One line for each layout: class, kind, bytes, bits."""
    return "".join(f"{layout.drawing()}\n" for layout in LAYOUTS)


def fields() -> str:
    """The table of fields; packets that encode a field alike share a row."""
    packets: dict[tuple[str, str, int, str], list[str]] = {}
    for layout in LAYOUTS:
        for name, bits in layout.fields:
            packets.setdefault((bits.letter, name, bits.width, bits.meaning), []).append(f"`{layout.packet}`")
    return HEAD + "".join(
        f"| `{letter}` | {name} | {width} | {', '.join(classes)} | {meaning} |\n"
        for (letter, name, width, meaning), classes in packets.items()
    )


def updated(page: str) -> str:
    """Return the page with the layouts replaced."""
    return re.sub(r"(?<=\n```packets\n).*?(?=```\n)", lambda _: layouts(), page, flags=re.S)


if __name__ == "__main__":
    PAGE.write_text(updated(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
