"""Scenes for the radio: robots that keep to the protocol, lie, or say nothing, where they stand, and who dies when."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import strategies as st

from netshaper.settings import RadioSettings
from protocol.budget import UNLIMITED, Budget
from tests.netshaper.network import Network, Step
from tests.netshaper.scripted_robots import Gossiper, Liar, Mute, Robot

seeds = st.integers(0, 2**32 - 1)
budgets = st.sampled_from((*map(Budget, (0, 1, 2, 3, 5, 7, 20, 64, 150, 1000)), UNLIMITED))
kinds = st.lists(st.sampled_from((Robot, Robot, Robot, Liar, Mute)), min_size=1, max_size=6)


@st.composite
def scenes(
    draw: st.DrawFn, robots: Any = kinds
) -> tuple[RadioSettings, dict[int, Robot], list[Any], list[Any]]:
    """Settings, robots, their cells in each step, and who dies when."""
    classes, seed = draw(robots), draw(seeds)
    count = len(classes)
    settings = RadioSettings(
        count, seed, draw(st.sampled_from((0.0, 3.0, 5.0, math.inf))), draw(budgets), draw(st.integers(1, 3))
    )
    rng = np.random.default_rng(seed)
    steps = draw(st.integers(1, 4))
    cells = [{r: tuple(rng.integers(0, 8, 2).tolist()) for r in range(count)} for _ in range(steps)]
    deaths = [
        {r: int(rng.integers(0, 60)) for r in range(count) if rng.random() < 0.08} for _ in range(steps)
    ]
    return settings, {n: kind(n, count, seed) for n, kind in enumerate(classes)}, cells, deaths


@st.composite
def gossip(draw: st.DrawFn, honest: bool = False) -> Any:
    """As `scenes`, of robots whose maps travel by gossip."""
    classes = (Gossiper, Gossiper, Mute) if honest else (Gossiper, Gossiper, Liar, Mute)
    teams = st.lists(st.sampled_from(classes), min_size=1, max_size=6)
    settings, *rest = draw(scenes(teams))
    return replace(settings, gossip=True), *rest


def play(scene: Any, interleaving: int = 0, deadly: bool = True) -> list[Step]:
    settings, robots, cells, deaths = scene
    network = Network(settings, robots, interleaving)
    return [network.step(1 + at, where, deaths[at] if deadly else {}) for at, where in enumerate(cells)]
