"""The measurements behind the tables in docs: functions that measure the cell of a row and a column (`docs.figures`).

Runs of sweeps are kept in ``build/figures``.
"""

from __future__ import annotations

import json
import os
import shlex
from functools import cache
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import Any

import polars as pl
from typer.testing import CliRunner

from deploy.commands.app import app
from deploy.run.failure import RunFailed
from deploy.study import experiment as experiments
from deploy.study.statistics import interval
from deploy.study.sweep import sweep
from docs.measured_table import DOCS, Row, Value
from worldsim.generators.seeds import first_test_seeds

SHARED = DOCS.parents[1] / "shared"
RUNS = DOCS.parent / "build" / "figures"


class NotThere(Exception):  # noqa: N818  it is no error of the program
    """Maps or logs that are not part of the repository are missing."""


@cache
def summary(command: str) -> dict[str, Any]:
    """Run ``murmur explore`` or ``play`` with these options on the memory bus, and return its summary.

    Raises
    ------
    RunFailed
        The command failed.
    """
    with TemporaryDirectory() as folder:
        out = str(Path(folder) / "run")
        done = CliRunner().invoke(app, [*shlex.split(command), "--bus", "memory", "--json", "--out", out])
    if done.exit_code not in (0, 1):
        raise RunFailed(f"murmur {command}: {done.stderr}")
    return dict(json.loads(done.stdout))


def mean_of(key: str, command: str, seeds: range) -> float:
    """The mean of a value of the summaries of a command's runs."""
    runs = [summary(f"{command} --seed {seed}") for seed in seeds]
    return fmean(each["bytes"]["total"] if key == "bytes" else each[key] for each in runs)


def swept(name: str, variant: str = "", **settings: Any) -> pl.DataFrame:
    """Return the runs of a shipped experiment, or of one of its variants, with other settings."""
    RUNS.mkdir(parents=True, exist_ok=True)
    read = experiments.read(Path(f"{name}.toml"))
    if variant:
        variants = {variant: read.variants[variant]}
        read = experiments.Experiment(**{**vars(read), "variants": variants, "table": _PLAIN})
    return sweep(read, out=RUNS / f"{name}.parquet", **settings).runs


_PLAIN = experiments.Table(rows=[], columns=[], values=["steps"])


def ratio(runs: pl.DataFrame, others: pl.DataFrame) -> str:
    """The mean ratio of steps of runs to others in the same order, with half of its interval."""
    found = interval((runs["steps"] / others["steps"]).to_list())
    return f"{found.mean:.2f} ± {found.high - found.mean:.2f}"


def rate(runs: pl.DataFrame) -> str:
    """Bytes per step of the whole team."""
    mean = float((runs["bytes.total"] / runs["steps"]).mean())  # type: ignore[arg-type]
    return f"{mean / 1000:.1f} kB" if mean >= 1000 else f"{mean:.1f} B"


def whole(runs: pl.DataFrame, name: str = "steps") -> str:
    """The mean of a column as a whole number."""
    return f"{runs[name].mean():.0f}"


def maps(*names: str) -> list[str]:
    """Paths of maps of real buildings, which are not part of the repository."""
    folder = Path(os.environ.get("MURMUR_MAPS", SHARED / "maps"))
    if missing := [name for name in names if not (folder / f"{name}.yaml").exists()]:
        raise NotThere(f"no {', '.join(missing)} in {folder}: set MURMUR_MAPS")
    return [str(folder / f"{name}.yaml") for name in names]


def percent(share: float, digits: int = 2) -> str:
    """A share as text; 100 % without digits would be too good."""
    return f"{100 * share:.{digits}f} %"


# Lessons


def lesson(row: Row, column: str) -> str:
    """Steps or bytes of the class's team by its bandwidth."""
    bandwidth = row["bandwidth"].partition(" ")[0]
    found = summary(f"explore --map office-plain --robots 3 --bandwidth {bandwidth}")
    return f"{found['bytes']['total']:,}" if column == "bytes transmitted" else str(found["steps"])


def exercise(row: Row, column: str) -> str | None:
    """Steps of the lesson's team by encoding and bandwidth; cells that the page leaves empty are not measured."""
    measured = {"scans": (50, 300, 2000, 4000, 8000), "predictive": (10, 20, 50, 300)}
    if (bandwidth := int(row["bandwidth"])) not in measured[column]:
        return None
    command = f"explore --map office-plain --robots 3 --map-encoding {column} --bandwidth {bandwidth}"
    return str(summary(command)["steps"])


# Radios


def losses(row: Row, column: str) -> str:
    """Steps of two seeds with and without lost frames."""
    radio, robots = row["radio, robots"].replace("`", "").split(", ")
    office = "--map office --set map_options.width_m=20 --set map_options.height_m=20 --strategy meier"
    loss = "" if column == "no loss" else " " + column.strip("`")
    command = f"explore {office} --radio {radio} --robots {robots}{loss}"
    return ", ".join(str(summary(f"{command} --seed {seed}")["steps"]) for seed in range(2))


def late_frames(row: Row, column: str) -> str:
    """Steps and bytes on imperfect radios."""
    office = "--map office --set map_options.width_m=12 --set map_options.height_m=12 --sensor-range 3"
    effect = {"perfect": "", "20 % loss": " --set radio.loss=0.2", "delay of 3 steps": " --set radio.delay=3"}
    dissemination = row["dissemination"].strip("`")
    command = f"explore {office} --strategy meier --dissemination {dissemination}{effect[column]}"
    return ", ".join(f"{mean_of(key, command, range(5)):.0f}" for key in ("steps", "bytes"))


# Real sensors

NOISY = "explore --map office --robots 5 --laser utm-30lx --pose graph-slam --bandwidth 60"


def agreement(found: dict[str, Any]) -> str:
    """How much of teammates' walls robots hold."""
    return f"{percent(found['walls_within_tolerance'])}, {percent(found['worst_walls_within_tolerance'])}"


def map_quality(row: Row, column: str) -> str:
    """Walls and accuracy of noisy maps."""
    polygons = " --map-encoding polygons --strategy meier" if "polygons" in row["encoding"] else ""
    found = summary(NOISY + polygons)
    if column.startswith("F1"):
        return f"{percent(found['claimed_mean_wall_f1'])}, {percent(found['claimed_worst_wall_f1'])}"
    return agreement(found) if column.startswith("agreement") else percent(found["map_accuracy"])


def baselines(row: Row, column: str) -> str:
    """Bytes and steps of encodings that send what teams with ROS send."""
    command = (
        f"explore --map office --map-encoding {row['encoding'].strip('`')} --dissemination gossip "
        "--bandwidth unlimited --laser utm-30lx --pose graph-slam"
    )
    return f"{mean_of(column, command, range(3)):,.0f}"


def tolerances(row: Row, column: str) -> str:
    """Bytes of noisy and exact maps, by tolerance."""
    exact = "explore --map office --robots 5 --bandwidth 60"
    lasers = exact if row["lasers"].startswith("exact") else NOISY
    found = summary(f"{lasers} --tolerance {row['tolerance']}")
    values = {
        "steps": str(found["steps"]),
        "bytes of updates": f"{found['bytes']['update']:,}",
        "all bytes": f"{found['bytes']['total']:,}",
    }
    return values.get(column) or agreement(found)


def recorded(row: Row, column: str) -> str:
    """Bytes and agreement of recorded logs."""
    log = SHARED / "logs" / f"{row['log']}.log.gz"
    if not log.exists():
        raise NotThere(f"no {log}: recorded logs are not part of the repository")
    robots = "--robots 2 --listeners 1" if "listener" in row["robots"] else f"--robots {row['robots']}"
    found = summary(f"play {log} {robots} {row['flags'].strip('`')} --bandwidth unlimited")
    return (
        f"{found['bytes_per_scan']:.1f}"
        if column == "B per scan"
        else agreement(found).replace("100.00", "100")
    )


# Encodings

RULES = {
    "default": "default", "thesis": "thesis", "default, `lazy = false`": "not lazy",
    "default, `mixed_first = false`": "not mixed first", "default, `free_inside_edges = true`": "free inside edges",
    "default, `unknown_pairs = true`": "unknown pairs", "default, `close_slivers = false`": "slivers stay open",
    "default, `wide_walls = false`": "thin walls",
}  # fmt: skip


def rates(row: Row, column: str) -> str:
    """Steps by encoding and bandwidth, of three and eight robots."""
    limit = row["bytes per step"]
    bandwidth = int(limit) if limit.isdecimal() else limit
    variant = "predictive" if "`backoff`" in column else f"{column}, gossip"
    return " / ".join(whole(swept("rate", variant, bandwidth=bandwidth, robots=robots)) for robots in (3, 8))


def options(row: Row, column: str) -> str:
    """Steps and accuracy by the options of polygons."""
    runs = swept("lossy", RULES[row["rules"]], seed=[0, 1])
    return whole(runs) if column == "steps" else f"{runs['map_accuracy'].mean():.3f}"


def kilobyte(row: Row, column: str) -> str:
    """Steps by the default rules, and by those of the thesis."""
    chosen: dict[str, Any] = {"map": maps(row["map"]), "robots": int(column.partition(" ")[0])}
    return " / ".join(whole(swept("kilobyte", rules, **chosen)) for rules in ("default", "thesis"))


def in_five_buildings(name: str, variant: str, **settings: Any) -> pl.DataFrame:
    """Return runs in five recorded buildings, ten test seeds each; the largest has a longer range and higher speed."""
    seeds = first_test_seeds(10)
    small = maps("intel", "fr079", "autolab", "aces")
    parts = [
        swept(name, variant, map=small, seed=seeds, **settings),
        swept(name, variant, map=maps("edmonton"), sensor_range=8, speed=1, seed=seeds, **settings),
    ]
    return pl.concat([part.select("steps", "bytes.total") for part in parts])


def against_scans(row: Row, column: str) -> str:
    """Steps and bytes of the predictive encoding, relative to raw scans."""
    runs = in_five_buildings("predictive", column, robots=int(row["robots"]))
    if column == "scans, unlimited":
        return f"{whole(runs)}, {rate(runs)}"
    scans = in_five_buildings("predictive", "scans, unlimited", robots=int(row["robots"]))
    return f"{ratio(runs, scans)}, {rate(runs)}"


def against_others(row: Row, column: str) -> str:
    """Steps of the default strategy by encoding, relative to raw scans."""
    chosen = {"map": row["map"], "robots": int(row["robots"]), "strategy": "repairmen"}
    scans = swept("default", "scans, unlimited", **chosen)
    return (
        whole(scans) if column.startswith("raw scans") else ratio(swept("default", column, **chosen), scans)
    )


def short_ranges(row: Row, column: str) -> str:
    """Steps of the predictive encoding at short ranges, relative to polygons."""
    chosen = {"robots": int(row["robots"]), "range": column.replace(" ", "")}
    fifty = in_five_buildings("seldom", "predictive, 50 B", **chosen)
    return ratio(fifty, in_five_buildings("seldom", "polygons, 1 kB", **chosen))


def narrow(row: Row, column: str) -> str:
    """Steps and bytes of a strategy at 25 bytes per step."""
    name, robots = column.split(", ")
    runs = swept("narrow", map=name, robots=int(robots), strategy=row["strategy"].strip("`"))
    return f"{whole(runs)}, {(runs['bytes.total'] / runs['steps']).mean():.0f} B"


# Reliability


def recovery(row: Row, column: str) -> str:
    """Steps and bytes until a restarted robot has recovered."""
    runs = swept("recovery", map_encoding=row["encoding"], dissemination=column.strip("`"))
    size = float(runs["recovery.bytes"].mean()) / 1000  # type: ignore[arg-type]
    return f"{whole(runs, 'recovery.steps')} steps, {size:.{1 if size < 10 else 0}f} kB"


def forwarding(row: Row, column: str) -> str:
    """Cells that are explored again with and without forwarding."""
    limit = row["bytes per step"]
    bandwidth = int(limit) if limit.isdecimal() else limit
    chosen = {"map_encoding": row["encoding"], "bandwidth": bandwidth}
    runs = swept("passing-on", forward_maps=column != "without forwarding", **chosen)
    return whole(runs, "recovery.exclusive" if column == "seen by B alone" else "recovery.reexplored")


# Strategies


def rivals(stem: str) -> Value:
    """Steps of strategies over those of `repairmen`; the recorded runs are beside the page."""

    def value(row: Row, column: str) -> str:
        encoding, robots = column.removesuffix(" robots").split(", ")
        name = f"{stem}{'scans' if encoding == 'scans' else 'outlines'}.csv"
        runs = pl.read_csv(DOCS / "results" / "repairmen" / name).filter(pl.col("robots") == int(robots))
        ours, theirs = (
            runs.filter(pl.col("strategy") == strategy)
            for strategy in ("repairmen", row["strategy"].strip("`"))
        )
        both = theirs.join(ours, on=["map", "seed"], suffix="_ours")
        return f"{(both['steps'] / both['steps_ours']).mean():.2f}"

    return value


def kinds(row: Row, column: str) -> str:
    """Steps of `repairmen` over those of others, by kind of building; the recorded runs are beside the page."""
    runs = pl.read_csv(DOCS / "results" / "kinds" / "training.csv")
    if row["map"] != "all":
        runs = runs.filter(pl.col("map") == row["map"].strip("`"))
    ours = runs.filter(pl.col("strategy") == "repairmen")
    if column == "runs":
        return str(len(ours))
    if column == "offline plan":
        return f"{(ours['steps'] / ours['offline_steps']).mean():.2f}"
    name, _, metric = column.partition(", ")
    name = _best_other(runs) if name == "best other" else name.strip("`")
    theirs = runs.filter(pl.col("strategy") == name)
    both = ours.join(theirs, on=["map", "seed"], suffix="_theirs")
    ratios = both[metric or "steps"] / both[f"{metric or 'steps'}_theirs"]
    return f"{ratios.mean():.2f}"


def _best_other(runs: pl.DataFrame) -> str:
    """The strategy other than `repairmen` with the fewest steps."""
    others = runs.filter(pl.col("strategy") != "repairmen")
    means = others.group_by("strategy").agg(pl.col("steps").mean()).sort("steps", "strategy")
    return str(means["strategy"][0])


PEER_COLUMNS = {
    "longest path to 95 %, m": ("longest_path_95", 0),
    "over `nearest`": ("", 2),
    "steps to 90 %": ("t90", 0),
    "steps to 95 %": ("t95", 0),
    "steps to 99 %": ("t99", 0),
    "bytes per step": ("bytes_per_step", 0),
    "T90": ("t90", 0),
    "T99": ("t99", 0),
    "T99 over `nearest`": ("t99", 2),
    "overlap": ("overlap_sum", 2),
    "spread": ("seen_std", 3),
    "longest path to T99, m": ("longest_path_99", 0),
    "steps until all know": ("steps", 0),
    "all know over `nearest`": ("steps", 2),
}
"""The metric of each column of the tables of peers, and its decimals."""


def peers(peer: str, compared: str) -> Value:
    """Means over the recorded runs by the rules of a peer; `compared` is the metric of the column over `nearest`."""

    def value(row: Row, column: str) -> str:
        runs = pl.read_csv(DOCS / "results" / "peers.csv").filter(pl.col("peer") == peer)
        if "robots" in row:
            runs = runs.filter(pl.col("robots") == int(row["robots"]))
        variant = (row.get("strategy") or row["variant"]).strip("`")
        ours = runs.filter(pl.col("variant") == variant)
        metric, digits = PEER_COLUMNS[column]
        if not column.endswith("over `nearest`"):
            return f"{ours[metric].mean():,.{digits}f}"
        metric = metric or compared
        nearest = runs.filter(pl.col("variant") == "nearest")
        both = ours.join(nearest, on=["map", "robots", "seed"], suffix="_nearest")
        return f"{(both[metric] / both[f'{metric}_nearest']).mean():.{digits}f}"

    return value


def short_range(_: Row, column: str) -> str:
    """Steps of `repairmen` over those of `meier`, by bandwidth and range."""
    bandwidth, reach = column.split(", ")
    variant = f"{reach}, {bandwidth}"
    chosen: dict[str, Any] = {"map": maps("intel", "fr079", "autolab")}
    ours, theirs = (swept("short-range", variant, strategy=name, **chosen) for name in ("repairmen", "meier"))
    return f"{(ours['steps'] / theirs['steps']).mean():.2f}"


def shipped_scenario(row: Row, _: str) -> str:
    """Steps of a shipped scenario."""
    return str(summary(row["command"].strip("`").removeprefix("murmur "))["steps"])
