"""The environments of the papers, drawn from a seed: `make("office", seed=3)`.

The papers show most of them only as pictures. The environments drawn here have the size and the features that
the texts describe; a seed determines rooms, doors and objects. Environments without random parts (`em`, `two-circles`,
`hilbert-*`, `leader-*`) are the same for all seeds.
"""

from __future__ import annotations

import importlib
import inspect
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from protocol.errors import there_are
from worldsim.map_error import MapError

if TYPE_CHECKING:
    from worldsim.maps import Map


@dataclass(frozen=True)
class _Environment:
    """The function that draws an environment, MODULE.NAME, and a description.

    The function receives `arguments`, then a random generator, and parameters by name.
    """

    function: str
    line: str
    arguments: tuple[int, ...] = ()

    def draw(self) -> Any:
        """Import the function; listing names must not import numpy."""
        module, name = self.function.split(".")
        return getattr(importlib.import_module(f"worldsim.generators.{module}"), name)


_ENVIRONMENTS: dict[str, _Environment] = {
    "unstructured": _Environment(
        "meier.unstructured",
        "outdoors, 25 x 25 m: objects of many shapes scattered over an enclosed field (Meier, Fig. 6.1a)",
    ),
    "mixed": _Environment(
        "meier.mixed",
        "outdoors and indoors, 25 x 25 m: a building with rooms, objects around it (Meier, Fig. 6.1b)",
    ),
    "office": _Environment(
        "meier.office", "indoors, 25 x 25 m: rooms along corridors, no obstacles (Meier, Fig. 6.1c)"
    ),
    "two-circles": _Environment(
        "meier.two_circles", "20 x 20 m: an empty field with two big discs in it (Meier, Fig. A.1)"
    ),
    "em": _Environment("faigl.em", "21 x 24 m without any obstacle (Faigl and Vanek, section 5)"),
    "autolab-like": _Environment(
        "faigl.autolab",
        "30 x 30 m: a research hall with screens, rooms on two sides, a wing (Faigl and Vanek, section 5)",
    ),
    "jh-like": _Environment(
        "faigl.jh",
        "21 x 24 m: an office building with small rooms along a corridor (Faigl and Vanek, section 5)",
    ),
    "potholes": _Environment(
        "faigl.potholes", "40 x 40 m with many small obstacles (Faigl and Vanek, section 5)"
    ),
    "office-plain": _Environment(
        "alkhawaldah.office_plain",
        "22 x 16 m: an office of wide rooms without obstacles (Al-khawaldah and Nüchter, section 4.1)",
    ),
    "office-obstacles": _Environment(
        "alkhawaldah.office_obstacles",
        "22 x 16 m: the same office with obstacles (Al-khawaldah and Nüchter, section 4.1)",
    ),
    "campus": _Environment(
        "alkhawaldah.campus",
        "outdoors, 120 x 90 m: buildings, courtyards, roads, trees (Al-khawaldah and Nüchter, section 4.2)",
    ),
    **{
        f"hilbert-{order}": _Environment(
            "alkhawaldah.hilbert",
            f"26 x 26 m: a corridor along a Hilbert curve of order {order} (Al-khawaldah and Nüchter, 4.3)",
            (order,),
        )
        for order in (1, 2, 3, 4)
    },
    **{
        f"hilbert-walls-{order}": _Environment(
            "alkhawaldah.hilbert_walls",
            f"26 x 26 m: one wall along a Hilbert curve of order {order} (Al-khawaldah and Nüchter, 4.3)",
            (order,),
        )
        for order in (1, 2, 3, 4)
    },
    "leader-trap": _Environment(
        "leader.trap",
        "10 x 10 m: rooms that trap robots attracted straight to the closest frontier (leader paper, Fig. 3)",
    ),
    "leader-rooms": _Environment(
        "leader.rooms",
        "10 x 10 m: rooms behind short screens, with and without leaders (leader paper, Figs. 4, 5)",
    ),
    "burgard-office": _Environment(
        "burgard.office",
        "36 x 27 m: an office of two corridors, many rooms with two doorways (Burgard et al., section IV-C)",
    ),
    "burgard-corridor": _Environment(
        "burgard.corridor",
        "48 x 15 m: a long corridor with rooms on both sides (Burgard et al., section IV-C)",
    ),
    "burgard-unstructured": _Environment(
        "burgard.unstructured",
        "30 x 27 m: an irregular outline with objects scattered inside (Burgard et al., section IV-C)",
    ),
}


def names() -> list[str]:
    """Return the names of all environments, paper by paper."""
    return list(_ENVIRONMENTS)


def describe(name: str) -> str:
    """Return a description of an environment, with its section or figure; MapError if no environment has this name."""
    return _environment(name).line


def make(name: str, seed: int = 0, **parameters: float) -> Map:
    """Draw an environment; the same `seed`, 0 or more, and parameters give the same cells.

    `parameters` replace the paper's values: `resolution` (meters per cell), and, if the size is variable, `width_m` and
    `height_m`, or `side_m` (meters).

    Raises MapError if the name or a parameter is unknown, or a value is out of range.
    """
    import numpy as np  # noqa: PLC0415

    from worldsim.maps import Map  # noqa: PLC0415

    environment = _environment(name)
    draw = environment.draw()
    if seed < 0:
        raise MapError(f"seed is {seed}; give 0 or more")
    known = {
        parameter.name: parameter.default
        for parameter in inspect.signature(draw).parameters.values()
        if parameter.kind is parameter.KEYWORD_ONLY
    }
    if unknown := [each for each in parameters if each not in known]:
        raise MapError(f"{name} has no parameter {unknown[0]!r}; it has {', '.join(known)}")
    chosen = known | parameters
    random = np.random.Generator(np.random.Philox(seed))
    return Map(name, draw(*environment.arguments, random, **chosen), float(chosen["resolution"]))


def _environment(name: str) -> _Environment:
    if name not in _ENVIRONMENTS:
        raise MapError(f"unknown map {name!r}; {there_are(_ENVIRONMENTS, name)}")
    return _ENVIRONMENTS[name]
