"""The plan of a run, derived from its scenario: the map, and the settings of world, relay and each robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from agent.replication.policies import GOSSIP
from agent.settings import MediumSettings, ReplicationSettings, Settings
from agent.strategies.registry import strategy
from deploy.scenario.bodies import bodies_of, sensors_of
from deploy.scenario.building_settings import BuildingSettings
from deploy.scenario.errors import ScenarioError
from deploy.scenario.finding_maps import find_map
from deploy.scenario.recording import Recording, load_recording
from deploy.scenario.scenario import Scenario
from netshaper.radio_models import PLUGINS as RADIO_MODELS
from netshaper.settings import RadioSettings
from protocol import faults
from protocol.body import Body, narrowest_opening
from protocol.budget import Budget
from protocol.errors import shown
from protocol.grid import FREE, Cell, Grid, Mask, enlarge
from worldsim.base import BaseWorld
from worldsim.maps import Map, MapError, to_cell, to_world
from worldsim.people import PeopleSettings
from worldsim.recorded.world import RecordedWorld
from worldsim.regions import nearest_cell
from worldsim.starts import jittered, start_cells
from worldsim.world import World, WorldSettings


@dataclass(frozen=True, eq=False)
class Plan:
    """All inputs of a run, derived from a scenario."""

    scenario: Scenario
    map: Map
    world: WorldSettings
    radio: RadioSettings
    robot_settings: dict[int, Settings]
    """The settings of each robot, by its number."""
    range_m: float
    """Communication range in meters."""
    incarnations: int = 1
    """How often each robot may start: once, and once more for each restart."""
    recording: Recording | None = None
    """The logs that robots replay; None: they explore a simulated building."""

    @property
    def has_truth(self) -> bool:
        """Whether `map` is the true map; else it is the one that a team in the field made."""
        return not self.scenario.is_field

    @cached_property
    def reachable(self) -> Mask:
        """The free cells that the team can see, shape (h, w); of a team in the field, the free cells of its map."""
        return self.make_world().reachable if self.has_truth else self.map.cells == FREE

    def make_world(self) -> BaseWorld:
        """Return the world in its initial state."""
        if self.recording is not None:
            return RecordedWorld(self.map.cells, self.world, self.recording.stretches)
        return World(self.map.cells, self.world)


def make(
    scenario: Scenario, world_map: Map | None = None, *, incarnations: int = 1, record_maps: bool = False
) -> Plan:
    """Derive the plan of a scenario; `world_map` replaces the map that the scenario names, unless it is recorded.

    Each robot may start `incarnations` times, or more often if the scenario's faults require it. With `record_maps`,
    robots report the changes of their maps to the recorder.

    Raises ScenarioError if the map or a log cannot be loaded, robots or people do not fit on it, a range is too small
    for its cells or for the strategy, or it is a record of robots in the field.
    """
    if scenario.is_field:
        raise ScenarioError("clock = 'field': is a record of robots in the field, which cannot be run")
    recording = load_recording(scenario) if scenario.is_recorded else None
    world_map = recording.map if recording is not None else world_map or load_map(scenario)
    incarnations = max(incarnations, faults.incarnations(scenario.faults))
    cell = world_map.resolution
    bodies = bodies_of(scenario, cell, recording, noisy=scenario.is_noisy)
    if recording is not None:
        starts = recording.starts
    else:
        starts = _starts(scenario, world_map, [body.radius_cells for body in bodies])
    range_m = scenario.range_m(world_map.diagonal_m)
    try:
        strategy(scenario.strategy).check_range(scenario.options, range_m)
    except ValueError as error:
        raise ScenarioError(f"range = {scenario.range!r}: {error}") from None
    world = _world_settings(scenario, bodies, starts, cell, recording)
    _check_people(world_map, world)
    radio = _radio_settings(scenario, world_map, range_m, incarnations)
    robot_settings = _robot_settings(scenario, world_map, bodies, radio, record_maps=record_maps)
    return Plan(scenario, world_map, world, radio, robot_settings, range_m, incarnations, recording)


def of_field(scenario: Scenario, world_map: Map | None = None) -> Plan:
    """Return the plan of a record of robots in the field: their map, hardware, and radio, but nothing to run.

    Raises ScenarioError if the map cannot be loaded.
    """
    world_map = world_map or load_map(scenario)
    bodies = bodies_of(scenario, world_map.resolution, noisy=scenario.is_noisy)
    range_m = scenario.range_m(world_map.diagonal_m)
    world = WorldSettings(tuple(bodies), (), scenario.beams, scenario.seed)
    return Plan(scenario, world_map, world, _radio_settings(scenario, world_map, range_m, 1), {}, range_m)


def _world_settings(
    scenario: Scenario, bodies: list[Body], starts: Sequence[Cell], cell: float, recording: Recording | None
) -> WorldSettings:
    """Return the settings of the world, with cells of `cell` meters."""
    chosen, people = strategy(scenario.strategy), scenario.people
    return WorldSettings(
        bodies=tuple(bodies),
        starts=tuple(starts),
        beams=scenario.beams,
        seed=scenario.seed,
        interference_cells=scenario.interference / cell,
        faults=tuple(fault for fault in scenario.faults if fault.kind not in faults.RADIO_KINDS),
        ends_with_all=scenario.finish == "all" or recording is not None or chosen.returns(scenario.options),
        cell_steps=scenario.motion == "cells",
        robots_collide=scenario.robots_collide,
        min_coverage=scenario.min_coverage,
        sensors=sensors_of(scenario, bodies, cell),
        people=PeopleSettings(people.number, people.speed / cell, people.radius / cell)
        if people.number
        else None,
        step_ns=scenario.step_ns,
    )


def _check_people(world_map: Map, settings: WorldSettings) -> None:
    """Raise ScenarioError if there are more people than free cells."""
    if settings.people is not None:
        try:
            World(world_map.cells, settings)
        except ValueError as error:
            raise ScenarioError(f"people.number on map {world_map.name}: {error}") from None


def _radio_settings(scenario: Scenario, world_map: Map, range_m: float, incarnations: int) -> RadioSettings:
    hardware = [scenario.body_of(number) for number in range(scenario.robots)]
    return RadioSettings(
        robots=scenario.robots,
        seed=scenario.seed,
        range_cells=range_m / world_map.resolution,
        budget=Budget.parse(scenario.bandwidth),
        rounds=scenario.rounds,
        gossip=scenario.dissemination == GOSSIP,
        incarnations=incarnations,
        options=scenario.radio,
        cell_m=world_map.resolution,
        walls=world_map.cells if RADIO_MODELS.find(scenario.radio.model).needs_walls else None,
        send=tuple(robot.send_bytes or scenario.radio.send_bytes for robot in hardware),
        receive=tuple(robot.receive_bytes or scenario.radio.receive_bytes for robot in hardware),
        changes=scenario.changes(world_map.diagonal_m),
        faults=tuple(fault for fault in scenario.faults if fault.kind in faults.RADIO_KINDS),
        step_ns=scenario.step_ns,
    )


def _robot_settings(
    scenario: Scenario, world_map: Map, bodies: list[Body], radio: RadioSettings, *, record_maps: bool
) -> dict[int, Settings]:
    # The sender of a broadcast does not notice without acknowledgments that a teammate is deaf.
    may_be_deaf = any(fault.kind == "deaf" for fault in scenario.faults)
    replication = ReplicationSettings(
        scenario.dissemination,
        forward_maps=scenario.forward_maps,
        requires_acks=not radio.perfect or (radio.gossip and may_be_deaf),
        round_trip=2 * (scenario.radio.delay + scenario.radio.jitter),
        digests=scenario.digests,
    )
    medium = MediumSettings(radio.budget, radio.range_cells, radio.packet_bytes)
    return {
        number: Settings(
            robot=number,
            bodies=tuple(bodies),
            width=world_map.width,
            height=world_map.height,
            beams=scenario.beams,
            seed=scenario.seed,
            strategy=scenario.strategy,
            encoding=scenario.encoding,
            replication=replication,
            medium=medium,
            options=scenario.options,
            resolution=world_map.resolution,
            min_frontier_cells=scenario.min_frontier_size / world_map.resolution,
            people=scenario.people.number > 0,
            incarnations=radio.incarnations,
            record_maps=record_maps,
        )
        for number in range(scenario.robots)
    }


def load_map(building: BuildingSettings) -> Map:
    """Load or generate the map of a building; raise ScenarioError if that fails."""
    try:
        return find_map(building.map, building.map_seed, building.map_options)
    except MapError as error:
        raise ScenarioError(str(error)) from None
    except OSError as error:
        raise ScenarioError(f"map = {shown(building.map)}: {error.strerror}") from None


def _starts(scenario: Scenario, world_map: Map, radii_cells: list[float]) -> list[Cell]:
    """Return each robot's start cell: `starts` first, the others around `start` or around a random cell."""
    floor = enlarge(world_map.cells, max(radii_cells))
    spacing = max(1, round(scenario.start_spacing / world_map.resolution), math.ceil(2 * max(radii_cells)))
    jitter = scenario.start_jitter / world_map.resolution
    given: list[Cell] = []
    try:
        first = None if scenario.start is None else _start_cell(world_map, floor, scenario.start)
        for robot, point in enumerate(scenario.starts[: scenario.robots]):
            own_floor = enlarge(world_map.cells, radii_cells[robot])
            cell = _start_cell(world_map, own_floor, point)
            if jitter:
                near = max(1, math.ceil(radii_cells[robot] + max(radii_cells[:robot], default=0.0)))
                cell = jittered(own_floor, cell, jitter, scenario.seed, robot, given, near)
            given.append(cell)
        if first is not None and jitter:
            first = jittered(floor, first, jitter, scenario.seed, len(given), (), 0)
        _check_apart(scenario, given, radii_cells)
        wide = 1
        if scenario.is_noisy:  # cells for the center of a robot in the narrowest opening
            wide = narrowest_opening(max(radii_cells), world_map.resolution) - math.ceil(2 * max(radii_cells))
        return start_cells(floor, scenario.robots, scenario.seed, spacing, first, given, wide=wide)
    except ValueError as error:
        raise ScenarioError(f"start on map {world_map.name}: {error}") from None


def _start_cell(world_map: Map, floor: Grid, point: tuple[float, float]) -> Cell:
    """Return the cell of a start position in meters.

    `floor` is the map for the center of the robot. Raises ValueError, in meters, if the position is outside the map, or
    its cell is not free.
    """
    height, width = floor.shape
    left, bottom = to_world(world_map, -0.5, height - 0.5)
    right, top = to_world(world_map, width - 0.5, -0.5)
    if not (left <= point[0] <= right and bottom <= point[1] <= top):
        raise ValueError(
            f"{_meters(*point)} is outside the map, which extends from {_meters(left, bottom)} to "
            f"{_meters(right, top)} (meters)"
        )
    column, row = map(round, to_cell(world_map, *point))
    x, y = min(max(column, 0), width - 1), min(max(row, 0), height - 1)
    if floor[y, x] != FREE:
        nearest = nearest_cell(floor == FREE, (x, y))
        hint = f"; the nearest free point is {_meters(*to_world(world_map, *nearest))}" if nearest else ""
        raise ValueError(f"{_meters(*point)} is not free: robots cannot start there{hint}")
    return x, y


def _meters(x: float, y: float) -> str:
    """Write a position as ``--start`` takes it."""
    return f"{round(x, 3):g},{round(y, 3):g}"


def _check_apart(scenario: Scenario, given: list[Cell], radii_cells: list[float]) -> None:
    """Raise ValueError if two robots that block each other would start in the same place."""
    for robot, (x, y) in enumerate(given if scenario.robots_collide else ()):
        for other, (other_x, other_y) in enumerate(given[:robot]):
            reach = max(1.0, radii_cells[robot] + radii_cells[other])
            if math.hypot(x - other_x, y - other_y) < reach:
                raise ValueError(
                    f"robots {other} and {robot} would start in the same place, {scenario.starts[robot]}"
                )
