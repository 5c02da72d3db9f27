"""From a scenario to the inputs of each process: the map, the start cells, the settings of relay, world, robots."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from agent.exchange import gossip
from agent.settings import Settings
from agent.strategies.registry import strategy
from deploy.scenario import world_map
from deploy.scenario.scenario import UNLIMITED, Scenario, ScenarioError
from netshaper import medium
from netshaper.radio import RadioSettings
from protocol.grid import disc, enlarge
from worldsim.map_error import MapError
from worldsim.maps import Map, to_cell
from worldsim.world import Body, World, WorldSettings, start_cells


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything that a run needs, derived from a scenario."""

    scenario: Scenario
    map: Map
    world: WorldSettings
    radio: RadioSettings
    minds: dict[int, dict[str, Any]]
    range_m: float

    def make_world(self) -> World:
        """The world in its initial state."""
        return World(self.map.cells, self.world)


def make(scenario: Scenario, on_map: Map | None = None) -> Plan:
    """Derive the plan of a scenario, on `on_map` instead of the map that it names if one is given.

    Raises
    ------
    ScenarioError
        The map cannot be loaded or made, the robots do not fit on it, or a range is too small for its cells
        or for the strategy.
    """
    on_map = on_map or load_map(scenario)
    cell = on_map.resolution
    bodies = []
    for number in range(scenario.robots):
        body = scenario.body_of(number)
        assert body.sensor_range and body.field_of_view and body.speed
        if body.sensor_range < cell:
            raise ScenarioError(
                f"sensor_range = {body.sensor_range:g} m of robot {number} is less than a cell of {cell:g} m"
            )
        if body.sensor_range < (least := least_range(scenario.radius / cell) * cell):
            raise ScenarioError(
                f"sensor_range = {body.sensor_range:g} m of robot {number} is less than {least:.3g} m: a disc of "
                f"radius = {scenario.radius:g} m would not see the walls that its next step touches"
            )
        bodies.append(
            Body(
                body.sensor_range / cell,
                body.field_of_view,
                body.speed / cell,
                scenario.scanner_turn,
                scenario.radius / cell,
            )
        )
    starts = _starts(scenario, on_map)
    range_m = scenario.range_m(on_map.diagonal_m)
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
        tuple((death.robot, death.step) for death in scenario.death),
        chosen.returns(scenario.options),
    )
    budget = medium.UNLIMITED if scenario.bandwidth == UNLIMITED else int(scenario.bandwidth)
    radio = RadioSettings(
        scenario.robots,
        scenario.seed,
        range_m / cell,
        budget,
        scenario.exchanges,
        scenario.offers == gossip.POLICY,
    )
    minds = {
        number: Settings(
            robot=number,
            robots=scenario.robots,
            width=on_map.width,
            height=on_map.height,
            ranges_cells=[body.range_cells for body in bodies],
            beams=scenario.beams,
            speed_cells=bodies[number].speed,
            seed=scenario.seed,
            exchange=scenario.exchange,
            strategy=scenario.strategy,
            offers=scenario.offers,
            bandwidth=None if scenario.bandwidth == UNLIMITED else float(scenario.bandwidth),
            reach_cells=range_m / cell,
            polygon=asdict(scenario.polygon),
            sight=asdict(scenario.sight),
            options=scenario.options,
            resolution=cell,
            radius_cells=bodies[number].radius_cells,
            field_of_view=bodies[number].field_of_view,
            scanner_turn=bodies[number].scanner_turn,
        ).to_message()
        for number in range(scenario.robots)
    }
    return Plan(scenario, on_map, world, radio, minds, range_m)


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
        return world_map.find(scenario.map, scenario.map_seed, scenario.map_options)
    except MapError as error:
        raise ScenarioError(str(error)) from None


def _starts(scenario: Scenario, on_map: Map) -> list[tuple[int, int]]:
    first = None
    if scenario.start is not None:
        x, y = to_cell(on_map, *scenario.start)
        first = round(x), round(y)
    radius_cells = scenario.radius / on_map.resolution
    apart = max(1, round(scenario.apart / on_map.resolution), math.ceil(2 * radius_cells))
    try:
        return start_cells(enlarge(on_map.cells, radius_cells), scenario.robots, scenario.seed, apart, first)
    except ValueError as error:
        hint = "" if first is None else f"; murmur map show {scenario.map} draws where they can"
        raise ScenarioError(f"start on map {on_map.name}: {error}{hint}") from None
