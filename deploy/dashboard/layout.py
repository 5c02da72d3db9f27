"""The layout of the dashboard: the true map, each robot's map, the radio, events."""

from __future__ import annotations

from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from deploy.dashboard.recorder import MARGIN, SHARES_HEIGHT, SMALL_MARGIN, TIMELINE
from deploy.dashboard.shapes import corner
from deploy.record.colors import QUIET
from deploy.scenario.plan import Plan

MOST, MOST_PAGES = 8, 8
"""Robot maps per tab, and tabs; larger teams have more maps per tab."""
MOST_CHOSEN = 32
"""Maximum number of robots for which there is also a view of the true map with this robot alone."""
SERIES_SHARES = [250, 200, 290, 270, 270]
"""Widths of the views below, in pixels of a window 1280 wide; the titles fit there."""


def layout(plan: Plan) -> rrb.Blueprint:
    """The layout of a run's dashboard; all text fits into a window of 1280 x 720 or more."""
    robots = range(plan.scenario.robots)
    world = _map("/world", "True map [m]", plan, ["/world/**", "/paths/**"], MARGIN)
    pages = _pages([_own_map(robot, plan) for robot in robots], "Maps")
    if 1 < len(robots) <= MOST_CHOSEN:
        pages += _pages([_chosen(robot, plan) for robot in robots], "True map")
    pages.append(rrb.TextDocumentView(origin="/help", name="Help"))
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(world, rrb.Tabs(*pages, active_tab=0), column_shares=[33, 67]),
            rrb.Horizontal(*_series(plan), column_shares=SERIES_SHARES),
            row_shares=[60, 40],
        ),
        rrb.TopPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        collapse_panels=True,
    )


def _pages(views: list[rrb.Spatial2DView], name: str) -> list[rrb.Grid]:
    """Views of robots in tabs, the first of which has the name: `MOST` in each, or more for at most `MOST_PAGES`."""
    most = max(MOST, -(-len(views) // MOST_PAGES))
    pages = []
    for first in range(0, len(views), most):
        shown = views[first : first + most]
        columns = len(shown) if len(shown) < 4 else -(-len(shown) // 2)
        last = first + len(shown) - 1
        numbers = f"{first}-{last}" if last > first else f"{first}"
        title = numbers if first else f"{name} {numbers}"
        pages.append(rrb.Grid(*shown, grid_columns=columns, name=title))
    return pages


def _own_map(robot: int, plan: Plan) -> rrb.Spatial2DView:
    contents = [f"/robots/{robot}/**", f"/paths/{robot}"]
    return _map(f"/robots/{robot}", f"Robot {robot} [m]", plan, contents, SMALL_MARGIN)


def _chosen(robot: int, plan: Plan) -> rrb.Spatial2DView:
    """The true map with one robot in color, with its path and target; the others are gray discs with numbers."""
    contents = ["+ /world/**", "- /world/targets/**", "- /world/ranges"]
    own = f"/paths/{robot}", f"/robots/{robot}/self", f"/robots/{robot}/target"
    contents += [f"+ {path}" for path in own]
    dimmed = {"/world/robots": rr.Points2D.from_fields(colors=[QUIET]).visualizer()}
    return _map("/world", f"Robot {robot} [m]", plan, contents, SMALL_MARGIN, dimmed)


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
        x_range=[left - pad, left + width + pad / 3], y_range=[top - pad / 3, top + height + 1.3 * pad]
    )
    return rrb.Spatial2DView(
        origin=origin, contents=contents, name=name, visual_bounds=bounds, overrides=overrides
    )


def _series(plan: Plan) -> list[rrb.View | rrb.Container]:
    """Traffic, map quality (with noisy sensors, the walls in front), backlog and missed steps, events."""
    quality = [
        _curves(origin, name, axis_y=rrb.ScalarAxis(range=(-7, 107)))
        for origin, name in (("/explored", "Explored [%]"), ("/walls", "Walls [%]"))
    ]
    waiting: rrb.View | rrb.Container = _curves("/backlog", "Undelivered [log entries]")
    if plan.scenario.clock != "barrier":
        waiting = rrb.Vertical(waiting, _curves("/missed", "Missed [steps]"))
    load = ["/traffic/load", "/traffic/budget", "/traffic/floor"]
    return [
        _curves("/traffic", "Transmitted [B/step]", contents=load),
        rrb.Spatial2DView(
            origin="/traffic/shares",
            name="By type [%]",
            visual_bounds=rrb.VisualBounds2D(x_range=[-6, 106], y_range=[-6, SHARES_HEIGHT]),
        ),
        rrb.Tabs(*quality, active_tab=1 if plan.scenario.is_noisy else 0),
        waiting,
        rrb.TextLogView(
            origin="/events",
            name="Events",
            columns=rrb.TextLogColumns(
                timeline_columns=[rrb.encodings.TimelineColumn(TIMELINE, visible=False)],
                text_log_columns=["Body"],
            ),
        ),
    ]


def _curves(origin: str, name: str, **more: Any) -> rrb.TimeSeriesView:
    """Curves over steps; the color tells the robot or the type, as a legend would cover the curves."""
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=rrb.PlotLegend(visible=False), **more)
