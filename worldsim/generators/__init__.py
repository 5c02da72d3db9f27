"""The environments of the papers, and further kinds of buildings, drawn from a seed: `make("office", seed=3)`.

The papers show most of them only as pictures. The environments drawn here have the size and the features that
the texts describe; a seed determines rooms, doors and objects. Environments without random parts (`em`, `two-circles`,
`hilbert-*`, `leader-*`, `burgard-five-rooms`, `burgard-two-rooms`) are the same for all seeds.
"""

from __future__ import annotations

import inspect
from functools import partial

import numpy as np

from protocol.errors import there_are
from worldsim.generators import alkhawaldah, burgard, faigl, leader, meier
from worldsim.generators.caves import caves
from worldsim.generators.drawing import Environment
from worldsim.generators.maze import maze
from worldsim.generators.office_campus import office_campus
from worldsim.generators.warehouse import warehouse
from worldsim.generators.wings import wings
from worldsim.maps import Map, MapError

_ENVIRONMENTS: dict[str, Environment] = {
    "unstructured": meier.unstructured,
    "mixed": meier.mixed,
    "office": meier.office,
    "two-circles": meier.two_circles,
    "em": faigl.em,
    "autolab-like": faigl.autolab,
    "jh-like": faigl.jh,
    "potholes": faigl.potholes,
    "office-plain": alkhawaldah.office_plain,
    "office-obstacles": alkhawaldah.office_obstacles,
    "campus": alkhawaldah.campus,
    "campus-roads": alkhawaldah.campus_roads,
    **{f"hilbert-{order}": partial(alkhawaldah.hilbert, order) for order in (1, 2, 3, 4)},
    **{f"hilbert-walls-{order}": partial(alkhawaldah.hilbert_walls, order) for order in (1, 2, 3, 4)},
    "leader-obstacles": leader.obstacles,
    "leader-trap": leader.trap,
    "leader-rooms": leader.rooms,
    "burgard-office": burgard.office,
    "burgard-corridor": burgard.corridor,
    "burgard-unstructured": burgard.unstructured,
    "burgard-five-rooms": burgard.five_rooms,
    "burgard-two-rooms": burgard.two_rooms,
    "warehouse": warehouse,
    "caves": caves,
    "maze": maze,
    "wings": wings,
    "office-campus": office_campus,
}


def names() -> list[str]:
    """Return the names of all environments, paper by paper."""
    return list(_ENVIRONMENTS)


def describe(name: str) -> str:
    """Return a description of an environment, with its section or figure; MapError if no environment has this name."""
    draw = _environment(name)
    text = inspect.getdoc(draw.func if isinstance(draw, partial) else draw) or ""
    return text.partition("\n")[0].removesuffix(".")


def make(name: str, seed: int = 0, **parameters: float) -> Map:
    """Draw an environment; the same `seed`, 0 or more, and parameters give the same cells.

    `parameters` replace the paper's values: `resolution` (meters per cell), and, if the size is variable, `width_m` and
    `height_m`, or `side_m` (meters); of some, also `clutter` (objects per 100 square meters).

    Raises MapError if the name or a parameter is unknown, or a value is out of range.
    """
    draw = _environment(name)
    if seed < 0:
        raise MapError(f"seed is {seed}; give 0 or more")
    signature = inspect.signature(draw).parameters.values()
    known = {each.name: each.default for each in signature if each.kind is each.KEYWORD_ONLY}
    if unknown := [each for each in parameters if each not in known]:
        raise MapError(f"{name} has no parameter {unknown[0]!r}; it has {', '.join(known)}")
    chosen = known | parameters
    random = np.random.Generator(np.random.Philox(seed))
    return Map(name, draw(random, **chosen), float(chosen["resolution"]))


def _environment(name: str) -> Environment:
    if name not in _ENVIRONMENTS:
        raise MapError(f"unknown map {name!r}; {there_are(_ENVIRONMENTS, name)}")
    return _ENVIRONMENTS[name]
