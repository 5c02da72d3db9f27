"""The coverage of radio presets from one place of a building, and a picture of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from deploy.record.map_pictures import save, show_grid
from deploy.record.number_texts import percent
from deploy.scenario.plan import Plan
from netshaper.connectivity import margin_db, walls_from
from protocol.grid import FREE, OCCUPIED

STEPS_DB = (0, 10, 20, 40, 1000)
"""Margins at which the color changes, in dB."""
COLORS = ListedColormap(["#c6dbef", "#6baed6", "#2171b5", "#08306b"])
PANEL_IN = 4.2
"""Width of a panel in inches."""
MOST_IN = 12.0
"""Height of a panel in inches at most."""

Margins = NDArray[np.float64]
"""How much stronger than necessary a robot in each cell receives, in dB; negative where it receives nothing."""


def coverage(plan: Plan) -> Margins:
    """Return how well robots in each cell receive one at the start place of robot 0; shape (height, width)."""
    options, (x, y) = plan.scenario.radio, plan.world.starts[0]
    cells = plan.map.cells
    rows, columns = np.indices(cells.shape)
    away: Margins = np.hypot(columns - x, rows - y).astype(np.float64)
    loss = options.db_per_wall * walls_from(cells, x, y).astype(np.float64)
    return margin_db(away, loss, plan.radio.range_cells, plan.map.resolution, options)


def draw_coverage(path: Path, plans: Mapping[str, Plan]) -> dict[str, float]:
    """Draw the coverage of radios on one map, a panel each; return the covered share of the free cells of each."""
    first = next(iter(plans.values())).map
    height = min(PANEL_IN * first.height / first.width, MOST_IN) + 1.6
    figure = Figure(figsize=(PANEL_IN * len(plans), height), layout="constrained")
    shares = {}
    norm = BoundaryNorm(STEPS_DB, COLORS.N)
    panels = figure.subplots(1, len(plans), squeeze=False)[0]
    for axes, (name, plan) in zip(panels, plans.items(), strict=True):
        margins = coverage(plan)
        shares[name] = float((margins[plan.map.cells == FREE] >= 0).mean())
        show_grid(axes, plan.map, plan.map.cells)
        shown = np.ma.masked_where((plan.map.cells == OCCUPIED) | (margins < 0), np.minimum(margins, 999))
        extent = axes.get_images()[0].get_extent()
        image = axes.imshow(shown, cmap=COLORS, norm=norm, extent=extent, interpolation="nearest")
        x, y = plan.world.starts[0]
        left, right, _, top = extent
        cell = (right - left) / plan.map.width
        axes.plot(left + (x + 0.5) * cell, top - (y + 0.5) * cell, "o", color="#d55e00", markersize=6)
        axes.set_title(f"{name}: {percent(shares[name], 0)} of the free cells", fontsize=10)
    bar = figure.colorbar(image, ax=panels.tolist(), location="bottom", shrink=0.5, ticks=STEPS_DB[:-1])
    bar.set_label("margin, dB; white: out of range; dot: the sender", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    save(path, figure, dpi=110)
    return shares
