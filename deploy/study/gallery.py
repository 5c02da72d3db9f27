"""All strategies in one picture: the paths of a team on the same map.

``python -m deploy.study.gallery FILE.png [--map NAME] [--robots N] [--seed S]`` draws it (docs/strategies.md).
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.progress import track

from agent.strategies.registry import strategies
from deploy.record.map_pictures import draw_paths, show_grid
from deploy.run import in_memory
from deploy.scenario import plan
from deploy.scenario.scenario import parse

COLUMNS = 4
PANEL_WIDTH, TITLE_HEIGHT = 3.6, 0.45
"""Size of a panel in inches."""


def draw(path: Path, names: list[str], scenario: dict[str, Any]) -> None:
    """Run a scenario with each strategy and draw one panel per strategy."""
    plans = {name: plan.make(parse(scenario | {"strategy": name})) for name in names}
    height, width = plans[names[0]].map.cells.shape
    rows = -(-len(names) // COLUMNS)
    size = PANEL_WIDTH * COLUMNS, (PANEL_WIDTH * height / width + TITLE_HEIGHT) * rows
    figure = Figure(figsize=size, layout="constrained")
    panels = np.atleast_1d(figure.subplots(rows, COLUMNS, sharex=True, sharey=True)).ravel()
    for panel, (name, made) in zip(panels, track(plans.items(), "strategies"), strict=False):
        records = in_memory.run(made)
        show_grid(panel, made.map, made.map.cells)
        draw_paths(panel, made, records)
        end = records.end
        done = end is not None and end.first >= 0
        panel.set_title(f"{name}: {records.step} steps" + ("" if done else ", stalled"), fontsize=10)
        panel.set_xlabel("")
    for panel in panels[len(names) :]:
        panel.set_axis_off()
    figure.savefig(path, dpi=80)


def main() -> None:
    """Draw the gallery given on the command line."""
    parser = argparse.ArgumentParser(description="Draw the robots' paths with each strategy.")
    parser.add_argument("file", type=Path, metavar="FILE.png")
    parser.add_argument("--map", default="office-obstacles", help="a generated environment")
    parser.add_argument("--robots", type=int, default=3)
    parser.add_argument("--seed", type=int, default=2)
    arguments = parser.parse_args()
    scenario = {
        "map": arguments.map, "robots": arguments.robots, "seed": arguments.seed,
        "map_encoding": "scans", "bandwidth": "unlimited",
        "bus": "memory", "sensor_range": 3.0, "speed": 0.5, "scanner_turn": 72,
    }  # fmt: skip
    draw(arguments.file, list(strategies()), scenario)


if __name__ == "__main__":
    main()
