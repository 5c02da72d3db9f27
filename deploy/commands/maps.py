"""`murmur map`: list, make and show maps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from deploy.commands.console import print_entries, screen
from deploy.commands.flag_values import named_values
from deploy.commands.flags import argument, command_family, file_option, option, subcommands

app = command_family()

OptionFlag = Annotated[
    list[str] | None, option("NAME=VALUE", "as width_m=60, height_m=40 or clutter=5; repeatable")
]
ResolutionFlag = Annotated[float | None, option("M", "meters per cell")]
maps_app = subcommands(app, "map", "List, make and show maps.")


@maps_app.command("list")
def map_list() -> None:
    """List the generators of maps; the YAML file of a ROS map can be used instead."""
    from worldsim import generators  # noqa: PLC0415

    print_entries({name: generators.describe(name) for name in generators.names()})


@maps_app.command("make")
def map_make(
    name: Annotated[str, argument("NAME", "a name from `murmur map list`")],
    seed: Annotated[int, option("S", "seed of the generator", min=0)] = 0,
    option: OptionFlag = None,
    resolution: ResolutionFlag = None,
    out: Annotated[Path | None, option("FILE.yaml", "default: NAME.yaml here")] = None,
) -> None:
    """Make a map and write it in the format of ROS map_server: a YAML file and its picture."""
    from worldsim import generators, maps  # noqa: PLC0415

    path = out or Path(f"{name}.yaml")
    if path.suffix not in (".yaml", ".yml"):
        raise ValueError(f"out = {path}: must end in .yaml")
    maps.save(generators.make(name, seed=seed, **map_options(option, resolution)), path)
    screen.print(f"{path}: {generators.describe(name)}, seed {seed}")


@maps_app.command("show")
def map_show(
    file: Annotated[str, argument("FILE|NAME", "a map file, or a generator's name")],
    seed: Annotated[int, option("S", "the generator's seed", min=0)] = 0,
    option: OptionFlag = None,
    resolution: ResolutionFlag = None,
    png: Annotated[Path | None, file_option("FILE.png", "draw the map with axes in meters")] = None,
) -> None:
    """Show a map in the terminal, with its size."""
    from deploy.commands.sketch import sketch  # noqa: PLC0415
    from deploy.scenario.finding_maps import find_map  # noqa: PLC0415

    world_map = find_map(file, seed, map_options(option, resolution))
    free = int((world_map.cells == 1).sum())
    screen.print(sketch(world_map.cells, screen))
    screen.print(
        f"{world_map.name}: {world_map.size}, {free} free cells ({100 * free / world_map.cells.size:.0f} %), "
        f"diagonal {world_map.diagonal_m:.1f} m"
    )
    if png is not None:
        from deploy.record.map_pictures import draw_map  # noqa: PLC0415

        draw_map(png, world_map)
        screen.print(f"drawn to {png}")


def map_options(texts: list[str] | None, resolution: float | None) -> dict[str, float]:
    """Return the options of a generator, given as NAME=VALUE; ValueError if one is not NAME=VALUE with a number."""
    options = named_values(texts or [], "option", "width_m=60")
    for name, value in options.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"option = '{name}={value}': must be a number")
        if name == "seed":
            raise ValueError("option = 'seed=...': use --seed")
    return options if resolution is None else options | {"resolution": resolution}
