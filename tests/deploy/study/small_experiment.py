"""A small experiment, shared by the tests of studies."""

from __future__ import annotations

from pathlib import Path

EXPERIMENT = """
name = "small"
[base]
map = "em"
map_encoding = "polygons"
strategy = "meier"
steps = 6
[grid]
robots = [1, 2]
seed = [0, 1]
[[variant]]
name = "polygons"
[[variant]]
name = "scans"
map_encoding = "scans"
[table]
rows = ["robots"]
columns = ["variant"]
values = ["steps", "bytes.total"]
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "small.toml"
    path.write_text(text)
    return path
