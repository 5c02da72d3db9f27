"""Installation of the dissector into the plugin folder of Wireshark and tshark."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from pathlib import Path

from netshaper.capture import VERDICTS
from netshaper.ledger import FIRST_ON_AIR, FRAMES
from protocol.packet_layout import LENGTH, Bits, Layout
from protocol.packets import LAYOUTS

TEMPLATE = Path(__file__).with_name("murmur.lua")
_OURS = "-- Murmur's radio for Wireshark"
"""First words of every version of the dissector."""


def plugin_folder() -> Path:
    """The folder from which the user's Wireshark loads Lua plugins: as tshark reports it, else the default."""
    tshark = shutil.which("tshark")
    if tshark is not None:
        asked = subprocess.run([tshark, "-G", "folders"], capture_output=True, text=True, check=False)
        for line in asked.stdout.splitlines():
            name, _, path = line.partition(":")
            if name.strip() == "Personal Lua Plugins" and path.strip():
                return Path(path.strip())
    if platform.system() == "Windows" and "APPDATA" in os.environ:
        return Path(os.environ["APPDATA"]) / "Wireshark" / "plugins"
    return Path.home() / ".local" / "lib" / "wireshark" / "plugins"


def install(folder: Path | None = None) -> Path:
    """Write the dissector into a plugin folder, replacing an older version of it; return its path.

    Raises ValueError if another file of that name exists, or the folder cannot be written.
    """
    target = (folder or plugin_folder()) / TEMPLATE.name
    try:
        if target.exists() and not target.read_text(encoding="utf-8", errors="replace").startswith(_OURS):
            raise ValueError(f"{target} already exists and is not Murmur's; move it away first")
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(dissector(), encoding="utf-8")
    except OSError as error:
        raise ValueError(f"{target}: cannot be written: {error.strerror}") from None
    return target


def dissector() -> str:
    """Return the Lua program of the dissector: the template, filled with the names and layouts of this version."""
    return TEMPLATE.read_text(encoding="utf-8").replace("@TABLES@", "\n".join(_tables()))


def _tables() -> list[str]:
    """The Lua tables that the template describes."""
    lines = [
        f"local {name} = {{ {_names(texts)} }}"
        for name, texts in (("FRAMES", FRAMES), ("VERDICTS", VERDICTS))
    ]
    lines += [f"local FIRST_ON_AIR = {FIRST_ON_AIR}", "local LAYOUTS = {"]
    lines += [f"  {_layout(layout)}," for layout in LAYOUTS]
    lines += ["}", "local FIELDS = {"]
    encodings: dict[str, Bits] = {}
    for name, bits in (field for layout in LAYOUTS for field in layout.fields if field[0] != LENGTH):
        if name not in encodings or bits.width > encodings[name].width:
            encodings[name] = bits
    lines += [
        f'  {{ "{name}", "{_type(bits)}", "{name.capitalize()}" }},' for name, bits in encodings.items()
    ]
    return [*lines, "}"]


def _names(texts: tuple[str, ...]) -> str:
    return ", ".join(f'[{number}] = "{text}"' for number, text in enumerate(texts))


def _layout(layout: Layout) -> str:
    fields = ", ".join(f'{{ "{name}", {bits.width}, {bits.bias} }}' for name, bits in layout.fields)
    content = "" if layout.content is None else f", content = {{ {layout.content[0]}, {layout.content[1]} }}"
    return (
        f'{{ name = "{layout.packet}", kind = "{layout.kind}", code = "{layout.code}", size = {layout.size}, '
        f"fields = {{ {fields} }}{content} }}"
    )


def _type(bits: Bits) -> str:
    """The Wireshark type that holds a field."""
    if bits.bias:
        return "int16"
    return next(f"uint{width}" for width in (8, 16, 32) if bits.width <= width)
