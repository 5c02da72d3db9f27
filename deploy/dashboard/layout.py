"""The layout of the dashboard: the true map, each robot's map, the radio, events."""

from __future__ import annotations

from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from deploy.dashboard.recorder import SHARES_HEIGHT, TIMELINE
from deploy.dashboard.shapes import corner
from deploy.record.colors import QUIET
from deploy.scenario.plan import Plan

MOST = 8
"""Maximum number of robot maps per tab."""
SERIES_SHARES = [30, 20, 19, 18, 16, 25]
"""Widths of the views below."""


def layout(plan: Plan) -> rrb.Blueprint:
    """The layout of a run's dashboard."""
    robots = range(plan.scenario.robots)
    world = _map("/world", "True map [m]", plan, ["/world/**", "/paths/**"], margin=0.12)
    chosen = [_chosen(robot, plan) for robot in robots] if len(robots) > 1 else []
    robot_maps = [
        _map(f"/robots/{robot}", f"Robot {robot} map", plan, [f"/robots/{robot}/**", f"/paths/{robot}"], 0.24)
        for robot in robots
    ]
    columns = len(robot_maps) if len(robot_maps) < 4 else -(-min(len(robot_maps), MOST) // 2)
    pages = [
        rrb.Grid(
            *robot_maps[first : first + MOST],
            grid_columns=columns,
            name=f"robots {first}-{min(first + MOST, len(robot_maps)) - 1}",
        )
        for first in range(0, len(robot_maps), MOST)
    ]
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Tabs(world, *chosen, active_tab=0) if chosen else world,
                rrb.Tabs(*pages) if len(pages) > 1 else pages[0],
                column_shares=[33, 67],
            ),
            rrb.Horizontal(*_series(plan), column_shares=SERIES_SHARES),
            row_shares=[63, 37],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        collapse_panels=True,
    )


def _chosen(robot: int, plan: Plan) -> rrb.Spatial2DView:
    """The true map with one robot in color, with its path and target; the others are gray discs with numbers."""
    contents = ["+ /world/**", "- /world/targets/**", "- /world/ranges"]
    own = f"/paths/{robot}", f"/robots/{robot}/self", f"/robots/{robot}/target"
    contents += [f"+ {path}" for path in own]
    dimmed = {"/world/robots": rr.Points2D.from_fields(colors=[QUIET]).visualizer()}
    return _map("/world", f"{robot}", plan, contents, 0.1, dimmed)


def _map(
    origin: str,
    name: str,
    plan: Plan,
    contents: list[str],
    margin: float,
    overrides: dict[str, Any] | None = None,
) -> rrb.Spatial2DView:
    left, top = corner(plan.map)
    width, height = plan.map.width * plan.map.resolution, plan.map.height * plan.map.resolution
    pad = margin * max(width, height)
    bounds = rrb.VisualBounds2D(
        x_range=[left - pad, left + width + pad / 2], y_range=[top - pad / 2, top + height + pad]
    )
    return rrb.Spatial2DView(
        origin=origin, contents=contents, name=name, visual_bounds=bounds, overrides=overrides
    )


def _series(plan: Plan) -> list[rrb.View | rrb.Container]:
    """Help, traffic, map quality (with noisy sensors, the walls in front), backlog and missed steps, events."""
    no_legend = rrb.PlotLegend(visible=False)
    quality = [
        rrb.TimeSeriesView(
            origin=origin, name=name, plot_legend=no_legend, axis_y=rrb.ScalarAxis(range=(0, 102))
        )
        for origin, name in (
            ("/explored", "Explored [%]"),
            ("/walls/f1", "Walls, F1 [%]"),
            ("/walls/precision", "Walls, precision [%]"),
        )
    ]
    waiting = [rrb.TimeSeriesView(origin="/backlog", name="Undelivered packets", plot_legend=no_legend)]
    if plan.scenario.clock != "barrier":
        waiting.append(rrb.TimeSeriesView(origin="/missed", name="Missed steps", plot_legend=no_legend))
    return [
        rrb.TextDocumentView(origin="/help", name="Help"),
        rrb.TimeSeriesView(
            origin="/traffic",
            contents=["/traffic/load", "/traffic/budget"],
            name="Transmitted [B]",
            plot_legend=no_legend,
        ),
        rrb.Spatial2DView(
            origin="/traffic/shares",
            name="Traffic by type",
            visual_bounds=rrb.VisualBounds2D(x_range=[-5, 105], y_range=[0, SHARES_HEIGHT]),
        ),
        rrb.Tabs(*quality, active_tab=1 if plan.scenario.is_noisy else 0),
        rrb.Tabs(*waiting) if len(waiting) > 1 else waiting[0],
        rrb.TextLogView(
            origin="/events",
            name="Events",
            columns=rrb.TextLogColumns(
                timeline_columns=[rrb.encodings.TimelineColumn(TIMELINE, visible=False)],
                text_log_columns=["Body"],
            ),
        ),
    ]
