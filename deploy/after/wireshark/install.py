"""Installs the dissector into the plugin folder of Wireshark and tshark."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from pathlib import Path

DISSECTOR = Path(__file__).with_name("murmur.lua")
_OURS = "-- Murmur's radio for Wireshark"
"""How every version of the dissector begins."""


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
    """Copy the dissector into a plugin folder, replacing an older version of it; return its path.

    Raises
    ------
    ValueError
        Another file of that name exists, or the folder cannot be written.
    """
    target = (folder or plugin_folder()) / DISSECTOR.name
    try:
        if target.exists() and not target.read_text(encoding="utf-8", errors="replace").startswith(_OURS):
            raise ValueError(f"{target} is there already and is not Murmur's; move it away first")
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(DISSECTOR, target)
    except OSError as error:
        raise ValueError(f"{target}: cannot be written: {error.strerror}") from None
    return target
