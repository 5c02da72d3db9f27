"""From a scenario to the inputs of each process: the map, the start cells, the settings of relay, world, robots."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from agent.replication.policies import GOSSIP
from agent.settings import Settings
from agent.strategies.registry import strategy
from deploy.scenario.finding_maps import find_map
from deploy.scenario.scenario import Scenario, ScenarioError
from deploy.scenario.tables import UNLIMITED
from netshaper.settings import RadioSettings
from protocol.budget import Budget
from protocol.grid import MAX_SIDE, disc, enlarge
from worldsim import faults
from worldsim.map_error import MapError
from worldsim.maps import Map, to_cell
from worldsim.starts import Cell, check_free, moved_about, start_cells
from worldsim.world import Body, World, WorldSettings


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything that a run needs, derived from a scenario."""

    scenario: Scenario
    map: Map
    world: WorldSettings
    radio: RadioSettings
    robot_settings: dict[int, Settings]
    range_m: float
    incarnations: int = 1
    """How often a robot may begin: more than once only where robots may come back (`worldsim.faults`)."""

    def make_world(self) -> World:
        """The world in its initial state."""
        return World(self.map.cells, self.world)


def make(scenario: Scenario, world_map: Map | None = None, *, incarnations: int = 1) -> Plan:
    """Derive the plan of a scenario, on `world_map` instead of the map that it names if one is given.

    Robots may begin as often as `incarnations` says, or more often if the scenario restarts them more often.

    Raises
    ------
    ScenarioError
        The map cannot be loaded or made, the robots do not fit on it, or a range is too small for its cells
        or for the strategy.
    """
    world_map = world_map or load_map(scenario)
    incarnations = max(incarnations, faults.incarnations(scenario.faults))
    cell = world_map.resolution
    bodies = []
    for number in range(scenario.robots):
        body = scenario.body_of(number)
        assert body.sensor_range and body.field_of_view and body.speed
        assert body.radius is not None
        assert body.scanner_turn is not None
        if body.sensor_range < cell:
            raise ScenarioError(
                f"sensor_range = {body.sensor_range:g} m of robot {number} is less than a cell of {cell:g} m"
            )
        if body.radius > MAX_SIDE * cell:
            raise ScenarioError(
                f"radius = {body.radius:g} m: no map is as large as that, with cells of {cell:g} m"
            )
        if body.sensor_range < (least := least_range(body.radius / cell) * cell):
            raise ScenarioError(
                f"sensor_range = {body.sensor_range:g} m of robot {number} is less than {least:.3g} m: a disc of "
                f"radius = {body.radius:g} m would not see the walls that its next step touches"
            )
        bodies.append(
            Body(
                body.sensor_range / cell,
                body.field_of_view,
                body.speed / cell,
                body.scanner_turn,
                body.radius / cell,
            )
        )
    starts = _starts(scenario, world_map, [body.radius_cells for body in bodies])
    range_m = scenario.range_m(world_map.diagonal_m)
    chosen = strategy(scenario.strategy)
    try:
        chosen.check_range(scenario.options, range_m)
    except ValueError as error:
        raise ScenarioError(f"range = {scenario.range!r}: {error}") from None
    world = WorldSettings(
        tuple(bodies),
        tuple(starts),
        scenario.beams,
        scenario.seed,
        scenario.interference / cell,
        scenario.faults,
        chosen.returns(scenario.options),
        scenario.motion == "cells",
        scenario.robots_collide,
    )
    budget = Budget.parse(scenario.bandwidth)
    radio = RadioSettings(
        scenario.robots,
        scenario.seed,
        range_m / cell,
        budget,
        scenario.rounds,
        scenario.dissemination == GOSSIP,
        incarnations,
        scenario.radio,
        cell,
        world_map.cells if scenario.radio.model != "disc" else None,
        tuple(scenario.body_of(number).send_bytes or 0 for number in range(scenario.robots)),
        tuple(scenario.body_of(number).receive_bytes or 0 for number in range(scenario.robots)),
        scenario.changes(world_map.diagonal_m),
    )
    robot_settings = {
        number: Settings(
            robot=number,
            robots=scenario.robots,
            width=world_map.width,
            height=world_map.height,
            ranges_cells=[body.range_cells for body in bodies],
            beams=scenario.beams,
            speed_cells=bodies[number].speed,
            seed=scenario.seed,
            map_encoding=scenario.map_encoding,
            strategy=scenario.strategy,
            dissemination=scenario.dissemination,
            bandwidth=None if scenario.bandwidth == UNLIMITED else float(scenario.bandwidth),
            reach_cells=range_m / cell,
            polygons=asdict(scenario.polygons),
            predictive=asdict(scenario.predictive),
            options=scenario.options,
            resolution=cell,
            radii_cells=[body.radius_cells for body in bodies],
            field_of_view=bodies[number].field_of_view,
            scanner_turn=bodies[number].scanner_turn,
            forward_maps=scenario.forward_maps,
            requires_acks=not radio.perfect or (radio.gossip and faults.deafen(scenario.faults)),
            fastest_cells=max(body.speed for body in bodies),
            frame_bytes=radio.packet_bytes,
            incarnations=incarnations,
        )
        for number in range(scenario.robots)
    }
    return Plan(scenario, world_map, world, radio, robot_settings, range_m, incarnations)


def least_range(radius_cells: float) -> float:
    """Sensor range with which a disc sees all cells that its next step, a diagonal one, may touch; in cells.

    It is 1 for robots so small that obstacles are not enlarged: they enter only cells that have been seen.
    """
    touched = disc(radius_cells)
    from_middle = np.argwhere(touched) - len(touched) // 2
    return float(np.hypot(*(from_middle + 1).T).max()) if len(from_middle) > 1 else 1.0


def load_map(scenario: Scenario) -> Map:
    """Load the scenario's map file, or make its generated map; ScenarioError says why not."""
    try:
        return find_map(scenario.map, scenario.map_seed, scenario.map_options)
    except MapError as error:
        raise ScenarioError(str(error)) from None


def _starts(scenario: Scenario, world_map: Map, radii_cells: list[float]) -> list[Cell]:
    """Where each robot starts: those of `starts` first, the others around `start`, or around a drawn cell."""
    floor = enlarge(world_map.cells, max(radii_cells))
    apart = max(1, round(scenario.start_spacing / world_map.resolution), math.ceil(2 * max(radii_cells)))
    jitter = scenario.start_jitter / world_map.resolution
    given: list[Cell] = []
    try:
        first = None if scenario.start is None else _cell(world_map, scenario.start)
        for robot, point in enumerate(scenario.starts[: scenario.robots]):
            own_floor = enlarge(world_map.cells, radii_cells[robot])
            cell = _cell(world_map, point)
            check_free(own_floor, cell)
            if jitter:
                near = max(1, math.ceil(radii_cells[robot] + max(radii_cells[:robot], default=0.0)))
                cell = moved_about(own_floor, cell, jitter, scenario.seed, robot, given, near)
            given.append(cell)
        if first is not None and jitter:
            first = moved_about(floor, first, jitter, scenario.seed, len(given), (), 0)
        _check_apart(scenario, given, radii_cells)
        return start_cells(floor, scenario.robots, scenario.seed, apart, first, given)
    except ValueError as error:
        is_drawn = scenario.start is None and not scenario.starts
        hint = "" if is_drawn else f"; murmur map show {scenario.map} draws where they can"
        raise ScenarioError(f"start on map {world_map.name}: {error}{hint}") from None


def _cell(world_map: Map, point: tuple[float, float]) -> Cell:
    x, y = to_cell(world_map, *point)
    return round(x), round(y)


def _check_apart(scenario: Scenario, given: list[Cell], radii_cells: list[float]) -> None:
    """Raise ValueError if two robots that block each other would start in one place."""
    for robot, (x, y) in enumerate(given if scenario.robots_collide else ()):
        for other, (other_x, other_y) in enumerate(given[:robot]):
            reach = max(1.0, radii_cells[robot] + radii_cells[other])
            if math.hypot(x - other_x, y - other_y) < reach:
                raise ValueError(
                    f"robots {other} and {robot} would start in one place, {scenario.starts[robot]}"
                )
