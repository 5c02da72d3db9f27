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
"""Robots that are shown at once; more of them go to tabs."""
RADIO_SHARES = [30, 20, 19, 18, 16, 25]
"""Widths of the views below."""


def layout(plan: Plan) -> rrb.Blueprint:
    """Lay the dashboard of a run out."""
    robots = range(plan.scenario.robots)
    world = _map("/world", "The building as it is [m]", plan, ["/world/**", "/ways/**"], margin=0.12)
    chosen = [_chosen(robot, plan) for robot in robots] if len(robots) > 1 else []
    robot_settings = [
        _map(f"/minds/{robot}", f"Robot {robot} knows", plan, [f"/minds/{robot}/**", f"/ways/{robot}"], 0.24)
        for robot in robots
    ]
    columns = len(robot_settings) if len(robot_settings) < 4 else -(-min(len(robot_settings), MOST) // 2)
    pages = [
        rrb.Grid(
            *robot_settings[first : first + MOST],
            grid_columns=columns,
            name=f"robots {first}-{min(first + MOST, len(robot_settings)) - 1}",
        )
        for first in range(0, len(robot_settings), MOST)
    ]
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Tabs(world, *chosen, active_tab=0) if chosen else world,
                rrb.Tabs(*pages) if len(pages) > 1 else pages[0],
                column_shares=[33, 67],
            ),
            rrb.Horizontal(*_radio(), column_shares=RADIO_SHARES),
            row_shares=[63, 37],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        collapse_panels=True,
    )


def _chosen(robot: int, plan: Plan) -> rrb.Spatial2DView:
    """The true map with one robot in its colour, its way and its target; the others are grey discs with numbers."""
    contents = ["+ /world/**", "- /world/targets/**", "- /world/ranges"]
    contents += [f"+ {path}" for path in (f"/ways/{robot}", f"/minds/{robot}/self", f"/minds/{robot}/target")]
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


def _radio() -> list[rrb.View]:
    no_legend = rrb.PlotLegend(visible=False)
    return [
        rrb.TextDocumentView(origin="/about", name="What you see"),
        rrb.TimeSeriesView(
            origin="/air",
            contents=["/air/load", "/air/budget"],
            name="On the air [B]",
            plot_legend=no_legend,
        ),
        rrb.Spatial2DView(
            origin="/air/shares",
            name="What for",
            visual_bounds=rrb.VisualBounds2D(x_range=[-5, 105], y_range=[0, SHARES_HEIGHT]),
        ),
        rrb.TimeSeriesView(
            origin="/explored",
            name="Explored [%]",
            plot_legend=no_legend,
            axis_y=rrb.ScalarAxis(range=(0, 102)),
        ),
        rrb.TimeSeriesView(origin="/backlog", name="Untold", plot_legend=no_legend),
        rrb.TextLogView(
            origin="/events",
            name="What happens",
            columns=rrb.TextLogColumns(
                timeline_columns=[rrb.encodings.TimelineColumn(TIMELINE, visible=False)],
                text_log_columns=["Body"],
            ),
        ),
    ]
