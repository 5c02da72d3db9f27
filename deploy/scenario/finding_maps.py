"""Load the map that a scenario names: a ROS map, an image with a resolution, or the name of a generator."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from protocol.errors import there_are
from worldsim import generators, maps
from worldsim.maps import Map, MapError

IMAGES = (".png", ".pgm")
OTHER_IMAGES = (".jpg", ".jpeg", ".bmp", ".gif", ".tif", ".tiff", ".webp")
FILES = (".yaml", ".yml", *IMAGES)
"""File name extensions of maps; all other names are those of generators."""


def find_map(name: str, seed: int, options: Mapping[str, float]) -> Map:
    """Load a map file, or generate a map with `seed` and `options`; an image has one option, ``resolution``.

    A file is searched in the working directory, then in the directory of the environment variable MURMUR_MAPS.

    Raises MapError if the map does not exist or cannot be read, or an option is unknown or missing.
    """
    extension = Path(name).suffix.lower()
    if extension in FILES and not Path(located(name)).exists():
        raise MapError(
            f"{name}: no such file, neither here nor in the directory that the environment variable MURMUR_MAPS names"
        )
    if extension in OTHER_IMAGES and Path(located(name)).is_file():
        raise MapError(f"map = {name!r}: a map is a PNG or PGM image, or a YAML file; save the image as PNG")
    if extension in IMAGES:
        return maps.load_picture(located(name), **_image_options(name, options))
    if extension in FILES or Path(name).is_file():
        found = maps.load(located(name))
        if "resolution" in options:
            raise MapError(
                f"resolution = {options['resolution']:g}: {name} itself gives the size of its cells, "
                f"{found.resolution:g} m; omit --resolution (map_options.resolution)"
            )
        if options:
            raise MapError(f"map_options.{min(options)}: {name} is a file; only generators have options")
        return found
    if Path(name).is_dir() and name not in generators.names():
        raise MapError(f"map = {name!r}: is a directory; give the YAML file of a map in it")
    if name not in generators.names():
        for extension in FILES:
            if Path(located(name + extension)).is_file():
                raise MapError(f"unknown map {name!r}; did you mean the file {name}{extension}?")
        raise MapError(
            f"unknown map {name!r}; {there_are(generators.names(), name)}; or give the YAML file of a map, or an "
            "image and --resolution"
        )
    if "name" in options or "seed" in options:
        raise MapError("map_options: name and seed are the settings map and map_seed")
    return generators.make(name, seed=seed, **options)


def located(name: str, folder: Path = Path()) -> str:
    """Return the path of a map file: in `folder`, unless only the directory of MURMUR_MAPS has such a file."""
    here, elsewhere = folder / name, Path(os.environ.get("MURMUR_MAPS", "")) / name
    return str(elsewhere if elsewhere.exists() and not here.exists() else here)


def _image_options(name: str, options: Mapping[str, float]) -> Mapping[str, float]:
    """Return the options of an image; raise MapError if the resolution is missing or another option is given."""
    unknown = sorted(set(options) - {"resolution"})
    if unknown:
        raise MapError(f"map_options.{unknown[0]}: unknown option for an image; valid: resolution")
    if "resolution" not in options:
        raise MapError(
            f"map = {name!r}: an image has no resolution: give --resolution METERS (per cell), or the YAML file of a "
            "map"
        )
    return options
