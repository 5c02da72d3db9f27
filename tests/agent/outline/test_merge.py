"""Merging: Algorithm 9 step by step and in one go, and the grid that an exact approximation represents."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from agent.outline.approximation import approximation, repair
from agent.outline.claims import THESIS, Drawing
from agent.outline.contour import contours
from agent.outline.edits import NumberedPolygons
from agent.outline.merge import ErrorCount, TeamMap, approximation_error, rendered
from agent.outline.objects import Objects
from agent.outline.polygons import Polygons
from agent.outline.receiver import Receiver
from agent.outline.simplify import refine
from deploy.bench.five_stages import UNDEFINED, five_stages
from protocol.boxes import NO_BOXES, Boxes
from protocol.grid import FREE, OCCUPIED, UNKNOWN, Grid
from protocol.packet_codec import encode
from tests.agent.explorations import Cell, exploration, grids, growing_maps, real_map
from tests.agent.outline.edit_scripts import edit_script, layer

quick = settings(deadline=None)

drawings = st.builds(Drawing, *6 * [st.booleans()])


def approximated(grid: Grid, robot: Cell, splits: int | None = None) -> Polygons:
    exact = contours(grid, robot)
    return approximation(exact, refine(exact, repair(Polygons.empty(grid.shape), exact), splits))


def merged(own: Grid, approximations: list[Polygons], drawing: Drawing = THESIS) -> Grid:
    team = TeamMap(drawing)
    for robot, polygons in enumerate(approximations):
        team.update(robot, Objects.of(polygons))
    return team.merged(own)


@st.composite
def teams(draw: st.DrawFn) -> tuple[Grid, list[Polygons]]:
    """A self-explored grid, and approximations of any fineness of teammates in the same environment."""
    steps = draw(growing_maps())
    own = steps[0][0]
    members = draw(st.lists(st.sampled_from(steps), max_size=4))
    fineness = st.sampled_from([0, 1, 4, None])
    return own, [approximated(grid, robot, draw(fineness)) for grid, robot in members]


@quick
@given(teams(), drawings)
def test_merging_equals_the_five_stages(case: tuple[Grid, list[Polygons]], drawing: Drawing) -> None:
    own, approximations = case
    assert (merged(own, approximations, drawing) == five_stages(own, approximations, drawing).complete).all()


def test_merging_equals_the_five_stages_on_a_real_map() -> None:
    world = real_map("fr079")
    walks = [list(exploration(world, np.random.default_rng(seed), 20, 40.0))[-1] for seed in range(4)]
    for splits in (0, 10, 100, None):
        team = [approximated(grid, robot, splits) for grid, robot in walks[1:]]
        assert (merged(walks[0][0], team) == five_stages(walks[0][0], team).complete).all()


def test_the_five_stages_are_those_of_figure_5_6() -> None:
    grid = np.full((7, 9), FREE, np.uint8)
    grid[0] = grid[-1] = OCCUPIED
    grid[2:5, 2:5] = UNKNOWN
    grid[2, 2:5] = OCCUPIED
    own = np.full(grid.shape, UNKNOWN, np.uint8)
    own[3, 3] = OCCUPIED
    stages = five_stages(own, [approximated(grid, (1, 1))])
    outside = np.s_[2:5, 2:5]
    assert (stages.outside_filled[outside] == UNKNOWN).all()
    assert (stages.outside_filled == UNDEFINED).sum() == grid.size - 9
    assert stages.outside_bounded[outside].tolist() == [[OCCUPIED] * 3, [UNKNOWN] * 3, [UNKNOWN] * 3]
    assert (stages.inside_filled[grid == FREE] == FREE).all()
    assert (stages.inside_filled[0] == UNDEFINED).all()
    assert (stages.inside_bounded[0] == OCCUPIED).all()
    assert stages.complete[3, 3] == OCCUPIED
    assert not (stages.complete == UNDEFINED).any()


def test_unknown_cells_of_one_teammate_that_another_has_seen_become_free() -> None:
    seen = np.full((9, 9), FREE, np.uint8)
    blind = seen.copy()
    blind[3:6, 3:6] = UNKNOWN
    nothing = np.full(seen.shape, UNKNOWN, np.uint8)
    for team in ([seen, blind], [blind, seen]):
        plan = merged(nothing, [approximated(grid, (0, 0)) for grid in team])
        assert (plan == FREE).all()
    assert merged(nothing, [approximated(blind, (0, 0))])[4, 4] == UNKNOWN


def test_an_occupied_boundary_overrides_unknown_and_free_areas_of_others() -> None:
    free = np.full((9, 9), FREE, np.uint8)
    pillar = free.copy()
    pillar[4, 4] = OCCUPIED
    speck = free.copy()
    speck[4, 4] = UNKNOWN
    nothing = np.full(free.shape, UNKNOWN, np.uint8)
    team = [approximated(grid, (0, 0)) for grid in (pillar, speck, free)]
    assert merged(nothing, team)[4, 4] == OCCUPIED


@quick
@given(teams())
def test_the_order_in_which_teammates_are_merged_does_not_matter(case: tuple[Grid, list[Polygons]]) -> None:
    own, approximations = case
    assert (merged(own, approximations) == merged(own, approximations[::-1])).all()
    backwards = five_stages(own, approximations[::-1])
    assert (backwards.complete == five_stages(own, approximations).complete).all()


@quick
@given(teams())
def test_the_self_explored_grid_overrides_all_claims(case: tuple[Grid, list[Polygons]]) -> None:
    own, approximations = case
    plan = merged(own, approximations)
    assert (plan[own != UNKNOWN] == own[own != UNKNOWN]).all()


@quick
@given(teams())
def test_a_new_approximation_replaces_that_teammates_old_one(
    case: tuple[Grid, list[Polygons]],
) -> None:
    own, approximations = case
    team = TeamMap()
    for polygons in approximations:
        team.update(1, Objects.of(polygons))
        assert (team.merged(own) == merged(own, [polygons])).all()


def where_they_differ(one: Grid, other: Grid) -> Boxes:
    """A box around all cells in which two grids differ."""
    ys, xs = np.nonzero(one != other)
    if not len(xs):
        return NO_BOXES
    return np.array([(xs.min(), ys.min(), xs.max() + 1, ys.max() + 1)], np.int32)


@quick
@given(growing_maps(), growing_maps(), st.sampled_from([0, 1, None]), drawings, st.data())
def test_incremental_merging_equals_merging_anew(
    own_steps: list[tuple[Grid, Cell]],
    team_steps: list[tuple[Grid, Cell]],
    splits: int | None,
    drawing: Drawing,
    data: st.DataObject,
) -> None:
    shape = own_steps[0][0].shape
    team_steps = [step for step in team_steps if step[0].shape == shape] or own_steps[::2]
    team, receivers, held = (
        TeamMap(drawing),
        [Receiver(shape) for _ in range(3)],
        [NumberedPolygons.empty(shape)] * 3,
    )
    before = own_steps[0][0]
    team.merged(before)
    for step, (own, _) in enumerate(own_steps):
        for robot in data.draw(st.sets(st.integers(0, 2))):
            grid, cell = team_steps[min(step, len(team_steps) - 1)]
            exact = contours(grid, cell)
            refined = refine(exact, repair(held[robot].polygons, exact), splits)
            packets, held[robot] = edit_script(held[robot], approximation(exact, refined))
            receivers[robot].feed(encode(packets))
            team.update(robot, receivers[robot].objects, receivers[robot].changed())
        near = data.draw(st.sets(st.integers(0, 3)))
        plan = team.merged(own, near, where_they_differ(before, own))
        anew = TeamMap(drawing)
        for robot, receiver in enumerate(receivers):
            if receiver.held.polygons.objects:
                anew.update(robot, Objects.of(receiver.held.polygons))
        assert plan.tolist() == anew.merged(own, near).tolist()
        before = own


@pytest.mark.parametrize("splits", [2, None])
def test_the_incremental_error_equals_the_error_counted_anew(splits: int | None) -> None:
    shape = real_map("fr079").shape
    receiver, held, before = Receiver(shape), NumberedPolygons.empty(shape), np.full(shape, UNKNOWN, np.uint8)
    drawing = Drawing(free_inside_edges=False, unknown_pairs=False)
    error = ErrorCount(drawing)
    error.count(before, receiver.objects)
    for step, (grid, cell) in enumerate(exploration(real_map("fr079"), np.random.default_rng(8), 20, 40.0)):
        if step % 3:
            exact = contours(grid, cell)
            refined = refine(exact, repair(held.polygons, exact), splits)
            packets, held = edit_script(held, approximation(exact, refined))
            receiver.feed(encode(packets))
        polygons = receiver.held.polygons
        counted = error.count(grid, receiver.objects, where_they_differ(before, grid), receiver.changed())
        assert counted == approximation_error(grid, polygons, drawing)
        before = grid


def reachable(grid: Grid, robot: Cell) -> NDArray[np.bool_]:
    areas, _ = ndimage.label(grid == FREE)
    free: NDArray[np.bool_] = areas == areas[robot[1], robot[0]]
    return free


def outer(free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells around the free space and not enclosed by it: 8-connected to the rim through non-free cells."""
    around, _ = ndimage.label(np.pad(~free, 1, constant_values=True), np.ones((3, 3)))
    outside: NDArray[np.bool_] = (around == around[0, 0])[1:-1, 1:-1]
    return outside


def what_algorithm_9_can_know(grid: Grid, robot: Cell, drawing: Drawing) -> Grid:
    """The grid without cells that no exact approximation can represent (`agent.outline.merge`)."""
    free = reachable(grid, robot)
    cross = ndimage.generate_binary_structure(2, 1)
    beside = ndimage.binary_dilation(free, cross) & ~free
    known = np.full(grid.shape, UNKNOWN, np.uint8)
    known[free] = FREE
    known[beside & (grid == OCCUPIED)] = OCCUPIED
    if drawing.free_inside_edges:
        known[beside & outer(free) & (grid != OCCUPIED)] = FREE
    return known


@quick
@given(grids(), st.booleans())
def test_an_exact_approximation_gives_the_grid_except_for_undetermined_cells(
    case: tuple[Grid, Cell], free_inside_edges: bool
) -> None:
    drawing = Drawing(free_inside_edges=free_inside_edges)
    expected = what_algorithm_9_can_know(*case, drawing)
    assert rendered(approximated(*case), drawing).tolist() == expected.tolist()


@pytest.mark.parametrize("name", ["intel", "fr079", "aces"])
@pytest.mark.parametrize("free_inside_edges", [True, False])
def test_an_exact_approximation_gives_real_maps(name: str, free_inside_edges: bool) -> None:
    drawing = Drawing(free_inside_edges=free_inside_edges)
    *_, seen = exploration(real_map(name), np.random.default_rng(2), 40, 30.0)
    y, x = np.argwhere(real_map(name) == FREE)[0].tolist()
    for grid, robot in (seen, (real_map(name), (x, y))):
        found = rendered(approximated(grid, robot), drawing)
        assert (found == what_algorithm_9_can_know(grid, robot, drawing)).all()


def test_the_error_counts_the_cells_that_differ() -> None:
    grid = np.full((9, 9), FREE, np.uint8)
    grid[3:6, 3:6] = OCCUPIED
    coarse, exact = (approximated(grid, (0, 0), splits) for splits in (0, None))
    assert approximation_error(grid, exact) == 1, "the middle of the block is on no contour"
    assert approximation_error(grid, coarse) == (grid != rendered(coarse)).sum() > 1


def test_unknown_pairs_are_left_out_if_the_option_is_off() -> None:
    grid = np.full((9, 9), FREE, np.uint8)
    grid[2, 2] = UNKNOWN
    grid[6, 6] = OCCUPIED
    specks = approximated(grid, (0, 0), 6)
    assert np.diff(specks.start).tolist() == [8, 2, 2]
    assert rendered(specks)[2, 2] == UNKNOWN
    clean = rendered(specks, Drawing(unknown_pairs=False))
    assert clean[2, 2] == FREE
    assert clean[6, 6] == OCCUPIED


def test_walls_of_outside_objects_override_free_inside_edges_if_wished() -> None:
    pillar = np.full((9, 12), FREE, np.uint8)
    pillar[4, 5] = OCCUPIED
    left = np.full(pillar.shape, UNKNOWN, np.uint8)
    left[:, :5] = FREE
    team = [approximated(grid, (0, 0)) for grid in (pillar, left)]
    nothing = np.full(pillar.shape, UNKNOWN, np.uint8)
    assert merged(nothing, team[:1])[4, 5] == OCCUPIED
    assert merged(nothing, team)[4, 5] == FREE, "as Algorithm 9 draws it"
    assert merged(nothing, team, Drawing(keep_walls=True))[4, 5] == OCCUPIED


def half_a_room() -> tuple[Polygons, Grid]:
    """A teammate's approximation of the left half of a room, and the cells behind it that the robot has seen itself."""
    room = np.full((9, 20), OCCUPIED, np.uint8)
    room[1:8, 1:12] = FREE
    room[:, 12:] = UNKNOWN
    own = np.full(room.shape, UNKNOWN, np.uint8)
    own[4, 12:14] = FREE
    return approximated(room, (3, 3)), own


def test_unknown_cells_beside_a_teammates_wall_become_wall_if_the_option_is_on() -> None:
    teammate, own = half_a_room()
    own[0, 13] = FREE
    plain, wide = (merged(own, [teammate], Drawing(wide_walls=wished)) for wished in (False, True))
    assert plain[0, 12] == UNKNOWN
    assert wide[0, 12] == OCCUPIED, "it touches the wall's last cell"
    assert (wide[own == FREE] == FREE).all()
    assert (wide[1:8, 1:12] == FREE).all(), "cells that a teammate has seen as free are no wall"
    assert (wide[2:7, 14:] == UNKNOWN).all(), "cells away from walls stay unknown"
    changed = wide != plain
    assert (plain[changed] == UNKNOWN).all()
    assert (wide[changed] == OCCUPIED).all()


def test_walls_that_the_robot_has_seen_itself_can_stay_thin() -> None:
    teammate, own = half_a_room()
    for seen, expected in ((UNKNOWN, OCCUPIED), (OCCUPIED, UNKNOWN)):
        own[0, 11] = seen
        all_wide, unseen = (
            merged(own, [teammate], Drawing(wide_walls=True, wide_seen_walls=wished))
            for wished in (True, False)
        )
        assert all_wide[0, 12] == OCCUPIED
        assert unseen[0, 12] == expected


def test_without_approximations_nothing_is_claimed() -> None:
    assert not layer(Polygons.empty((4, 5))).any()
    own = np.array([[FREE, UNKNOWN]], np.uint8)
    assert TeamMap().merged(own).tolist() == own.tolist()
