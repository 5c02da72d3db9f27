"""Maps of the world, read and written in the format of ROS' map_server.

A map on disk is a YAML file and the picture that it names. map_server's frame is in meters, with y up and the
origin at the lower left corner of the picture. Murmur's frame is in cells, with y down (`protocol.grid`). Only
`to_world` and `to_cell` convert between the two.
"""

from __future__ import annotations

import io
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from protocol.errors import shown
from protocol.files import read_file
from protocol.grid import FREE, MAX_SIDE, OCCUPIED, UNKNOWN, Grid
from protocol.map_frame import MapFrame
from worldsim.atomic_files import write_whole

_OCCUPIED_THRESH = 0.65
_FREE_THRESH = 0.196
_SHADES = np.array([205, 254, 0], np.uint8)
"""Gray values of unknown, free and occupied cells in written pictures."""

MOST_RESOLUTION = 1000.0
"""Maximum of meters per cell: messages contain positions in millimeters, as 32-bit integers."""
MOST_ORIGIN = 1e8
"""Maximum coordinate in meters: more than twice the circumference of the earth."""


class MapError(ValueError):
    """A map is invalid; the message names the place, the error and a remedy."""


@dataclass(frozen=True, eq=False)
class Map:
    """A map of the world as a grid of cells.

    Raises MapError if cells, resolution or origin are invalid, or no cell is free.
    """

    name: str
    """The map's name in results."""
    cells: Grid
    """`protocol.grid` states, uint8 of shape (height, width), row 0 on top; robots never enter unknown ones."""
    resolution: float
    """Side of a cell in meters."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pose of the lower left corner of the lower left cell in the world's frame: x and y in meters, yaw in radians
    (always 0).
    """

    def __post_init__(self) -> None:
        if self.cells.ndim != 2 or self.cells.dtype != np.uint8:
            raise MapError(
                f"cells are {self.cells.dtype} of shape {self.cells.shape}, not uint8 rows and columns"
            )
        if max(self.cells.shape) > MAX_SIDE:
            raise MapError(_too_large(self.width, self.height))
        if not 0 < self.resolution <= MOST_RESOLUTION:
            raise MapError(
                f"resolution is {self.resolution}, not a number of meters per cell above 0, {MOST_RESOLUTION:g} at most"
            )
        if not all(abs(value) <= MOST_ORIGIN for value in self.origin):
            raise MapError(f"origin is {list(self.origin)}, not three numbers of {MOST_ORIGIN:g} at most")
        if self.origin[2] != 0:
            raise MapError(
                f"origin is rotated by {self.origin[2]} rad; rotate the picture instead and give a yaw of 0"
            )
        if not np.isin(self.cells, (UNKNOWN, FREE, OCCUPIED)).all():
            raise MapError(
                f"a cell has state {self.cells.max()}; the states are 0 unknown, 1 free, 2 occupied"
            )
        if not (self.cells == FREE).any():
            raise MapError(
                "no cell is free; check negate and the thresholds, or draw free space in white "
                "(transparent pixels count as dark)"
            )

    @property
    def width(self) -> int:
        """Number of cells from left to right."""
        return int(self.cells.shape[1])

    @property
    def frame(self) -> MapFrame:
        """Where the grid lies in the world's frame."""
        return MapFrame(self.width, self.height, self.resolution, *self.origin[:2])

    @property
    def height(self) -> int:
        """Number of cells from top to bottom."""
        return int(self.cells.shape[0])

    @property
    def size(self) -> str:
        """The size in cells and in meters, as text."""
        width_m, height_m = self.width * self.resolution, self.height * self.resolution
        return (
            f"{self.width} x {self.height} cells of {self.resolution:g} m, {width_m:.1f} x {height_m:.1f} m"
        )

    @property
    def diagonal_m(self) -> float:
        """Length of the map's diagonal in meters; with this radio range all robots are always connected."""
        return math.hypot(self.width, self.height) * self.resolution


def to_world(map_: Map, x: float, y: float) -> tuple[float, float]:
    """Convert a point of the cell frame (y down, centers at whole numbers) to meters, y up."""
    left, bottom, _ = map_.origin
    return left + (x + 0.5) * map_.resolution, bottom + (map_.height - 0.5 - y) * map_.resolution


def to_cell(map_: Map, mx: float, my: float) -> tuple[float, float]:
    """Convert a point in meters to the cell frame; rounding the result gives the cell's index."""
    left, bottom, _ = map_.origin
    return (mx - left) / map_.resolution - 0.5, map_.height - 0.5 - (my - bottom) / map_.resolution


def load(path: str | os.PathLike[str]) -> Map:
    """Read a map from map_server's YAML file and the PGM or PNG picture that it names.

    A pixel's darkness p ranges from 0 (white) to 1 (black), reversed with `negate`. A cell is occupied if
    p > occupied_thresh, free if p < free_thresh, else unknown. The channels of a color picture are averaged, including
    opacity, as in map_server's trinary mode. The map has the name of the YAML file.

    Raises MapError if the YAML file or the picture is missing, malformed, or has impossible values.
    """
    path = Path(path)
    entries = _read_yaml(path)
    image = entries["image"]
    if not isinstance(image, str) or not image:
        raise MapError(f"{path}: image is {shown(image)}, not the name of a file")
    resolution = _number(path, "resolution", entries["resolution"])
    origin = _origin(path, entries["origin"])
    occupied, free = (_share(path, key, entries[key]) for key in ("occupied_thresh", "free_thresh"))
    if free > occupied:
        raise MapError(
            f"{path}: free_thresh {free} is above occupied_thresh {occupied}; it must not be greater"
        )
    negate = entries["negate"]
    if negate not in (0, 1):
        raise MapError(f"{path}: negate is {shown(negate)}; give 0 (white is free) or 1 (black is free)")
    mode = entries.get("mode", "trinary")
    if mode != "trinary":
        raise MapError(f"{path}: mode is {shown(mode)}; only trinary is supported (free, occupied, unknown)")

    return _from_picture(path, path.parent / image, resolution, origin, (free, occupied), negate=bool(negate))


def load_picture(path: str | os.PathLike[str], resolution: float) -> Map:
    """Read a map from a PGM or PNG picture without YAML file, with `resolution` meters per pixel.

    White is free, black occupied, gray unknown, by map_server's default thresholds; the origin is the lower left
    corner.

    Raises MapError if the picture is missing or malformed, or contains no valid map.
    """
    path = Path(path)
    origin, thresholds = (0.0, 0.0, 0.0), (_FREE_THRESH, _OCCUPIED_THRESH)
    return _from_picture(path, path, resolution, origin, thresholds, negate=False)


def _from_picture(
    path: Path,
    image: Path,
    resolution: float,
    origin: tuple[float, float, float],
    thresholds: tuple[float, float],
    *,
    negate: bool,
) -> Map:
    """Convert a picture to the map named after `path`; `thresholds` are the free and the occupied one."""
    shade, white = _read_picture(image)
    darkness = (shade if negate else white - shade) / white
    cells = np.full(shade.shape, UNKNOWN, np.uint8)
    cells[darkness < thresholds[0]] = FREE
    cells[darkness > thresholds[1]] = OCCUPIED
    try:
        return Map(path.stem, cells, resolution, origin)
    except MapError as error:
        raise MapError(f"{path}: {error}") from None


def save(map_: Map, yaml_path: str | os.PathLike[str]) -> None:
    """Write a map as map_server's YAML file and a PNG picture of the same name beside it.

    Each file is written atomically, the YAML file last, so that every YAML file has its picture. The map's name is not
    stored: a map has the name of its file.

    Raises OSError if a file cannot be written; the error names it.
    """
    yaml_path = Path(yaml_path)
    image = yaml_path.with_suffix(".png")
    entries = {
        "image": image.name,
        "resolution": float(map_.resolution),
        "origin": [float(value) for value in map_.origin],
        "negate": 0,
        "occupied_thresh": _OCCUPIED_THRESH,
        "free_thresh": _FREE_THRESH,
    }
    text = yaml.safe_dump(entries, sort_keys=False, default_flow_style=None)
    picture = Image.fromarray(_SHADES[map_.cells])
    write_whole(image, lambda file: picture.save(file, "PNG"))
    write_whole(yaml_path, lambda file: file.write(text.encode()))


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        entries = yaml.safe_load(read_file(path))
    except RecursionError:
        raise MapError(
            f"{path}: is nested too deeply; a map_server YAML file has `key: value` lines"
        ) from None
    except OSError as error:
        raise MapError(f"{path}: cannot be read ({error.strerror}); give a map_server YAML file") from None
    except (yaml.YAMLError, ValueError) as error:
        raise MapError(f"{path}: is not YAML ({' '.join(str(error).split())})") from None
    if not isinstance(entries, dict):
        raise MapError(
            f"{path}: contains no `key: value` lines; a map_server YAML file names image, resolution, origin"
        )
    for key in ("image", "resolution", "origin", "occupied_thresh", "free_thresh", "negate"):
        if key not in entries:
            raise MapError(f"{path}: {key} is missing")
    return entries


def _number(path: Path, key: str, value: Any) -> float:
    """Parse a number as ROS does, which accepts 1e-1; for YAML that is a text."""
    try:
        if isinstance(value, int | float | str) and not isinstance(value, bool):
            return float(value)
    except (ValueError, OverflowError):
        pass
    raise MapError(f"{path}: {key} is {shown(value)}, not a number")


def _share(path: Path, key: str, value: Any) -> float:
    share = _number(path, key, value)
    if not 0 <= share <= 1:
        raise MapError(f"{path}: {key} is {share}; it must lie between 0 and 1")
    return share


def _origin(path: Path, value: Any) -> tuple[float, float, float]:
    if not isinstance(value, list) or len(value) != 3:
        raise MapError(f"{path}: origin is {shown(value)}, not [x in meters, y in meters, yaw in radians]")
    x, y, yaw = (_number(path, "origin", part) for part in value)
    return x, y, yaw


def _read_picture(path: Path) -> tuple[NDArray[np.float64], int]:
    """Read a picture's gray values, of shape (height, width), and the value of white."""
    try:
        data = read_file(path)
    except OSError as error:
        raise MapError(
            f"{path}: cannot be read ({error.strerror}); a map's picture must be a PGM or PNG file"
        ) from None
    try:
        with Image.open(io.BytesIO(data), formats=("PNG", "PPM")) as picture:
            picture.verify()
        with Image.open(io.BytesIO(data), formats=("PNG", "PPM")) as picture:
            if max(picture.size) <= MAX_SIDE:
                return _shades(picture)
            reason = _too_large(*picture.size)
    except Image.DecompressionBombError:
        reason = f"has more than {MAX_SIDE} x {MAX_SIDE} cells; crop it or use larger cells"
    except UnidentifiedImageError:
        reason = "is not a complete PGM or PNG picture" if data else "is empty; give a PGM or PNG picture"
    except Exception as error:  # Pillow raises errors of many types for damaged pictures
        reason = f"is not a complete PGM or PNG picture ({str(error) or 'damaged'})"
    raise MapError(f"{path}: {reason}")


def _shades(picture: Image.Image) -> tuple[NDArray[np.float64], int]:
    if picture.mode == "F":
        raise ValueError("its gray values are fractions; give whole numbers of 8 or 16 bits")
    if picture.mode.startswith("I"):
        return np.array(picture, np.float64), 65535
    if picture.mode in ("1", "L"):
        return np.array(picture.convert("L"), np.float64), 255
    colors = np.array(picture.convert("RGBA" if picture.has_transparency_data else "RGB"), np.float64)
    mean: NDArray[np.float64] = colors.sum(axis=2) / colors.shape[2]
    return mean, 255


def _too_large(width: int, height: int) -> str:
    return f"is {width} x {height} cells, and the maximum is {MAX_SIDE} x {MAX_SIDE}; crop it or use larger cells"
