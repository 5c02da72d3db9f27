"""`murmur radio`: list radio presets, and show their coverage."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from deploy.commands.console import print_entries, screen
from deploy.commands.flag_values import position
from deploy.commands.flags import argument, command_family, file_option, option, subcommands
from protocol.presets import PRESETS

app = command_family()
radio_app = subcommands(app, "radio", "List radio presets, and show their coverage.")


@radio_app.command("list")
def radio_list() -> None:
    """List the radio presets, with ranges behind walls and legal limits (docs/radios.md)."""
    lines = {}
    for name, preset in PRESETS.items():
        assert preset.link is not None
        ranges = ", ".join(f"{preset.link.range_m(walls)}" for walls in (0, 2, 4))
        duty = f"{100 * preset.limit.duty_cycle:g} %" if preset.limit.duty_cycle < 1 else "no"
        lines[name] = (
            f"{preset.description}; {preset.bandwidth} bytes per second; {ranges} m behind 0, 2, 4 walls; "
            f"{duty} duty cycle, {preset.limit.source}"
        )
    print_entries(lines)


@radio_app.command("coverage")
def radio_coverage(
    names: Annotated[str, argument("NAME,...", "radio presets, a panel each")],
    map_: Annotated[str, option("FILE|NAME", "the building", name="--map")] = "office",
    map_seed: Annotated[int, option("S", "the generator's seed", min=0)] = 0,
    resolution: Annotated[
        float | None, option("M", "meters per cell of a generated map, or of a map that is a picture")
    ] = None,
    at: Annotated[str | None, option("X,Y", "the place in meters (default: where robots start)")] = None,
    out: Annotated[Path, file_option("FILE.png", "the picture")] = Path("coverage.png"),
) -> None:
    """Draw where robots receive one that stands in one place, with each of some radio presets."""
    from deploy.record.coverage import draw_coverage  # noqa: PLC0415
    from deploy.record.number_texts import percent  # noqa: PLC0415
    from deploy.scenario import plan as plans  # noqa: PLC0415
    from deploy.scenario.scenario import load  # noqa: PLC0415

    settings = {
        "map": map_, "map_seed": map_seed, "map_options.resolution": resolution, "robots": 1,
        "start": position(at, "at") if at else None,
    }  # fmt: skip
    listed = [name.strip() for name in names.split(",")]
    shares = draw_coverage(
        out, {name: plans.make(load(None, {**settings, "radio.preset": name})) for name in listed}
    )
    for name, share in shares.items():
        screen.print(f"{name}: {percent(share)} of the free cells are in range")
    screen.print(f"drawn to {out}")
