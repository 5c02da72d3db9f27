"""A chaos case: a scenario, faults and byzantine robots, all drawn from one seed.

A run begins with a safety phase: robots are killed, restarted and stopped, their radios fail to send or to receive, and
teams are partitioned. By the step `CALM` all faults have healed, except for robots that stay dead; at least one robot
lives. In the following liveness phase the remaining robots must finish. Loss, delay, duplication and bit errors of the
medium, changes of its bandwidth, and byzantine robots last for the whole run.

If a case runs as processes, connections of robots to the hub are cut as well; this must not change the result.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deploy.chaos.cut_connections import Cut
from deploy.chaos.false_maps import LIES
from deploy.scenario.scenario import Scenario, parse
from deploy.scenario.tables import MAX_TOLERANCE
from protocol.keyed_random import keyed_random

CALM = 120
"""The step by which all faults have healed."""

STEPS = 3000
"""The step by which a team must have finished."""

MAPS = (
    "leader-rooms", "leader-trap", "office-plain", "office-obstacles", "hilbert-1", "unstructured", "mixed", "office",
)  # fmt: skip
STRATEGIES = ("meier", "meier", "burgard", "greedy", "nearest", "repairmen")
BANDWIDTHS = (500, 2000, 10000, "unlimited")
NARROW_BANDWIDTHS = (15, 20, 30, 41)
"""Bandwidths below which the predictive encoding codes scans otherwise (`agent.encodings.update_packets.NARROW`)."""
RANGES = ("25%", "50%", "100%")
LASTING = ("stop", "mute", "deaf")


@dataclass(frozen=True)
class ChaosCase:
    """One run under random faults; the radios of the robots in `byzantine` send hostile frames.

    Robots in `flipped` receive frames in which bits have flipped although the checksum holds.
    `false_map` is a robot whose map is false, and how (`deploy.chaos.false_maps`). The robots in `heavy` send messages
    of many megabytes to world, recorder and relay.
    """

    seed: int
    scenario: Scenario
    byzantine: tuple[int, ...] = ()
    flipped: tuple[int, ...] = ()
    false_map: tuple[int, str] | None = None
    heavy: tuple[int, ...] = ()
    cuts: tuple[Cut, ...] = ()

    def smaller(self) -> list[ChaosCase]:
        """Cases with one fault less each, for shrinking a failing case."""
        base = self.scenario.model_dump()
        faults = base["fault"]
        kept = [faults[:at] + faults[at + 1 :] for at in range(len(faults))]
        changes = [{"fault": fault} for fault in kept]
        changes += [{key: _DEFAULTS[key]} for key in ("radio", "change") if base[key] != _DEFAULTS[key]]
        cases = [replace(self, byzantine=(), false_map=None)] if self.byzantine or self.false_map else []
        cases += [replace(self, flipped=())] if self.flipped else []
        cases += [replace(self, heavy=(), cuts=())] if self.heavy or self.cuts else []
        for change in changes:
            with contextlib.suppress(ValueError):  # a restart may be invalid without the kill before it
                cases.append(replace(self, scenario=parse(base | change)))
        return cases


_DEFAULTS = Scenario().model_dump()


def case(seed: int) -> ChaosCase:
    """Draw a case.

    A new kind of fault draws from a generator of its own, by a new purpose, so that all seeds keep their other faults:
    a further draw from an existing one, or a further value to choose from, would replace all cases.
    """
    draw = keyed_random(seed, "storm")
    robots = int(draw.integers(2, 6))
    map_encoding = str(draw.choice(["polygons", "polygons", "scans", "predictive"]))
    bandwidths = BANDWIDTHS[2:] if map_encoding == "scans" else BANDWIDTHS
    settings: dict[str, Any] = {
        "map": str(draw.choice(MAPS)), "map_seed": int(draw.integers(100)),
        "robots": robots, "map_encoding": map_encoding,
        "dissemination": str(draw.choice(["backoff", "thesis", "gossip"])),
        "strategy": str(draw.choice(STRATEGIES)),
        "bandwidth": bandwidths[int(draw.integers(len(bandwidths)))], "range": str(draw.choice(RANGES)),
        "sensor_range": float(draw.choice([2.5, 4.0])), "seed": seed, "steps": STEPS, "bus": "memory",
    }  # fmt: skip
    settings["fault"] = _faults(draw, robots)
    if draw.random() < 0.5:
        settings["radio"] = _radio(draw, robots)
    byzantine = (int(draw.integers(robots)),) if robots > 2 and draw.random() < 0.3 else ()
    if draw.random() < 0.25:
        step, bandwidth = int(draw.integers(1, CALM)), bandwidths[int(draw.integers(len(bandwidths)))]
        settings["change"] = [{"step": step, "bandwidth": bandwidth, "range": str(draw.choice(RANGES))}]
    flipped = (int(draw.integers(robots)),) if draw.random() < 0.3 else ()
    narrow = keyed_random(seed, "narrow")
    if map_encoding == "predictive" and settings["dissemination"] == "gossip" and narrow.random() < 0.5:
        settings["bandwidth"] = int(narrow.choice(NARROW_BANDWIDTHS))
    settings["digests"] = bool(byzantine or flipped)
    tolerant = keyed_random(seed, "tolerance")
    if map_encoding == "predictive" and tolerant.random() < 0.5:
        settings["tolerance"] = int(tolerant.integers(1, MAX_TOLERANCE + 1))
    frontiers = keyed_random(seed, "frontiers")
    if frontiers.random() < 0.3:
        settings["min_frontier_size"] = float(frontiers.choice([0.2, 0.3, 0.5]))
    lies = keyed_random(seed, "false map")
    false_map = (int(lies.integers(robots)), str(lies.choice(list(LIES))))
    is_exact = map_encoding != "polygons" and "tolerance" not in settings
    can_lie = robots > 2 and not byzantine and is_exact and lies.random() < 0.3
    cuts, heavy = _connections(seed, robots)
    scenario = parse(settings)
    return ChaosCase(seed, scenario, byzantine, flipped, false_map if can_lie else None, heavy, cuts)


def _connections(seed: int, robots: int) -> tuple[tuple[Cut, ...], tuple[int, ...]]:
    """Connections that are cut or reset, in two cases of three, and a robot that sends long messages.

    In some cases, the relay's link is cut as well: all connections in one step.
    """
    draw = keyed_random(seed, "connections")
    cuts = tuple(
        Cut(int(draw.integers(1, CALM)), int(draw.integers(robots)), bool(draw.random() < 0.5))
        for _ in range(int(draw.integers(0, 3)))
    )
    heavy = (int(draw.integers(robots)),) if draw.random() < 0.3 else ()
    if draw.random() < 0.3:
        step, reset = int(draw.integers(1, CALM)), bool(draw.random() < 0.5)
        cuts += tuple(Cut(step, robot, reset) for robot in range(robots))
    return cuts, heavy


def _faults(draw: np.random.Generator, robots: int) -> list[dict[str, Any]]:
    """The faults of each robot in their order; at least one robot lives at the end."""
    faults: list[dict[str, Any]] = []
    survivor = int(draw.integers(robots))
    for robot in range(robots):
        step, alive = 1, True
        for _ in range(int(draw.integers(4))):
            step += int(draw.integers(1, CALM // 3))
            if step > CALM // 2:
                break
            kind = str(draw.choice(["kill", "restart", *LASTING] if alive else ["restart"]))
            fault: dict[str, Any] = {"step": step, "robot": robot, "kind": kind}
            if kind in LASTING:
                fault["steps"] = int(draw.integers(1, CALM // 4))
                step += fault["steps"]
            alive = kind != "kill"
            faults.append(fault)
        if not alive and (robot == survivor or draw.random() < 0.5):
            faults.append({"step": step + int(draw.integers(1, 10)), "robot": robot, "kind": "restart"})
    return faults


def _radio(draw: np.random.Generator, robots: int) -> dict[str, Any]:
    """A medium that loses, delays, duplicates and damages frames, or partitions the team for a while."""
    radio: dict[str, Any] = {}
    if draw.random() < 0.5:
        radio["loss"] = float(draw.choice([0.05, 0.2]))
    if draw.random() < 0.3:
        radio["delay"] = int(draw.integers(1, 4))
    if draw.random() < 0.2:
        radio["duplication"] = 0.1
    if draw.random() < 0.2:
        radio["bit_errors"] = 1e-4
    if draw.random() < 0.6:
        first = int(draw.integers(1, CALM // 2))
        last = first + int(draw.integers(1, CALM // 2))
        group = draw.permutation(robots)[: int(draw.integers(1, robots))]
        radio["partition"] = [{"first": first, "last": last, "groups": [sorted(group.tolist())]}]
    return radio
