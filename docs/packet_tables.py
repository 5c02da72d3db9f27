"""The packet layouts and the table of their fields in docs/protocol.md, generated from `protocol.packets`.

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
    """The rows of the table of fields; packets that encode a field alike share a row."""
    packets: dict[tuple[str, str, int, str], list[str]] = {}
    for layout in LAYOUTS:
        for name, bits in layout.fields:
            packets.setdefault((bits.letter, name, bits.width, bits.meaning), []).append(f"`{layout.packet}`")
    return "".join(
        f"| `{letter}` | {name} | {width} | {', '.join(classes)} | {meaning} |\n"
        for (letter, name, width, meaning), classes in packets.items()
    )


def updated(page: str) -> str:
    """Return the page with both generated parts replaced."""
    page = re.sub(r"(?<=\n```packets\n).*?(?=```\n)", lambda _: layouts(), page, flags=re.S)
    return re.sub(re.escape(HEAD) + r"(\|[^\n]*\n)*", lambda _: HEAD + fields(), page)


if __name__ == "__main__":
    PAGE.write_text(updated(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
