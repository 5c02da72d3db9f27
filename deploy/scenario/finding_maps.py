"""Finding the map that a scenario names: a ROS map, a picture with a scale, or the name of a generator."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from protocol.errors import there_are
from worldsim import generators, maps
from worldsim.map_error import MapError
from worldsim.maps import Map

PICTURES = (".png", ".pgm")
FILES = (".yaml", ".yml", *PICTURES)
"""How the names of map files end; others are names of generators."""


def find_map(name: str, seed: int, options: Mapping[str, float]) -> Map:
    """Load the map of a file, or make a generated one.

    Parameters
    ----------
    name : str
        The path of a file, or a name of `murmur map list`.
    seed : int
        Of the generator.
    options : mapping of str to float
        Parameters of the generator; of a picture ``resolution``, metres a cell.

    Raises
    ------
    MapError
        There is no such map, it cannot be read or drawn, or it has no such options.
    """
    if name.endswith(PICTURES):
        return maps.load_picture(name, **_picture_options(name, options))
    if name.endswith(FILES) or Path(name).is_file():
        if options:
            raise MapError(f"map_options: {name} is a file; only generated maps have options")
        return maps.load(name)
    if Path(name).is_dir() and name not in generators.names():
        raise MapError(f"map = {name!r}: is a folder; give the YAML file of a map in it")
    if name not in generators.names():
        raise MapError(
            f"no environment is called {name!r}; {there_are(generators.names(), name)}; or give the YAML file of a "
            "map, or its picture and --resolution"
        )
    return generators.make(name, seed=seed, **options)


def _picture_options(name: str, options: Mapping[str, float]) -> Mapping[str, float]:
    """What a picture is read with; MapError if its scale is not said, or something else is."""
    unknown = sorted(set(options) - {"resolution"})
    if unknown:
        raise MapError(f"map_options.{unknown[0]}: a picture has no such option; there is: resolution")
    if "resolution" not in options:
        raise MapError(
            f"map = {name!r}: a picture does not say how large its cells are: give --resolution METRES, or the YAML "
            "file of a map"
        )
    return options
