"""Commands for many runs: `murmur sweep`, `reproduce`, `compare`, `size`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from deploy.commands.console import errors, screen
from deploy.commands.flag_values import named_values, names, whole_numbers
from deploy.commands.flags import (
    argument,
    command_family,
    figure_flags,
    file_option,
    option,
    switch,
)
from deploy.commands.scenario_flags import setting_flags
from deploy.commands.study_flags import (
    JobsOption,
    RetryFlag,
    SchedulerOption,
    SeedsOption,
    SetOption,
    other_settings,
)
from deploy.commands.study_output import end_study, print_table, report_failures, report_sweep, stopping
from deploy.scenario.tables import MAX_RUNS
from deploy.study.progress import counting
from protocol.grid import MAX_ROBOTS
from protocol.presets import PRESETS
from worldsim.generators.seeds import first_test_seeds

app = command_family()

BANDWIDTHS, RANGES = ("100", "1000", "10000"), ("30%", "100%")
"""Bandwidths and ranges that `murmur size` tries by default."""


@app.command()
@figure_flags
def sweep(
    experiment: Annotated[Path, argument("EXPERIMENT.toml", "the experiment's file (docs/experiments.md)")],
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    set_: SetOption = None,
    seeds: SeedsOption = None,
    test_seeds: Annotated[
        int | None, option("N", "run N test seeds, from 1000 on (docs/maps.md)", min=1, max=MAX_RUNS)
    ] = None,
    variant: Annotated[list[str] | None, option("NAME", "run only this variant; repeatable")] = None,
    quick: Annotated[bool, switch("--quick", "apply the [quick] section of the file")] = False,
    out: Annotated[
        Path | None, file_option("FILE.parquet", "the table of runs; existing runs are reused")
    ] = None,
    table: Annotated[
        Path | None, file_option("FILE.csv|.parquet", "write means, intervals and quartiles")
    ] = None,
    plot: Annotated[
        Path | None,
        file_option("FILE.png|.pdf|.svg", "draw the file's plots (FILE-2.png and so on for more)"),
    ] = None,
    retry: RetryFlag = False,
    *,
    style: Any,
) -> None:
    """Run a scenario over a grid of settings, on the memory bus, and print the table defined in the file.

    Exit code 3: runs failed.
    """
    from deploy.study import experiment as experiments  # noqa: PLC0415
    from deploy.study.results import Results, write_table  # noqa: PLC0415
    from deploy.study.runs import cases  # noqa: PLC0415
    from deploy.study.sweep import Sweep  # noqa: PLC0415

    if style.formats and not (plot or table):
        raise ValueError("formats: needs --plot FILE or --table FILE, the names of the files")
    if out is not None and table is not None and out.resolve() == table.resolve():
        raise ValueError(f"table = {table}: is also the file of --out; name another file")
    settings = _sweep_settings(set_ or [], seeds, test_seeds)
    read = experiments.read(experiment)
    if plot is not None and not read.plots:
        raise ValueError(f"plot = {plot}: {experiment} has no table [[plot]]; add one, or omit --plot")
    read = experiments.quickened(read) if quick else read
    read = experiments.override(experiments.choose(read, variant or []), settings)
    with stopping(out), Results(out) as results:
        done = Sweep(cases(read), results, read)
        try:
            done.make(jobs=jobs, scheduler=scheduler, retry=retry)
        finally:
            report_sweep(done)
            if table is not None and done.rows:
                write_table(done.table, table)
                done.write_tables(table.with_suffix(""), style)
        if plot is not None:
            for number in range(len(read.plots)):
                file = plot.with_stem(f"{plot.stem}-{number + 1}") if number else plot
                style.save(done.plot(number, style), file)
        end_study(done.failures)


def _sweep_settings(texts: list[str], seeds: int | None, test_seeds: int | None) -> dict[str, Any]:
    """The settings of --set, --seeds, and --test-seeds; ValueError if several of them give seeds."""
    settings = named_values(texts, "set", "seed=[0,1]")
    given = {
        "--seeds": seeds and list(range(seeds)),
        "--test-seeds": test_seeds and first_test_seeds(test_seeds),
        "--set seed": settings.get("seed"),
    }
    chosen = [flag for flag, value in given.items() if value is not None]
    if len(chosen) > 1:
        raise ValueError(f"{' and '.join(chosen)}: give only one of them")
    return settings | {"seed": given[flag] for flag in chosen}  # noqa: B035  at most one


@app.command()
@figure_flags
def reproduce(
    claim: Annotated[
        list[str] | None, argument("CLAIM...", "as B1 M4, or files with a claim (default: all 24)")
    ] = None,
    quick: Annotated[bool, switch("--quick", "fewer seeds and smaller grids")] = False,
    seeds: SeedsOption = None,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    out: Annotated[
        Path, option("STEM", "output: STEM.md, STEM.html, and folder STEM with pictures and tables")
    ] = Path("reproduction"),
    retry: RetryFlag = False,
    *,
    style: Any,
) -> None:
    """Repeat the experiments of the papers, and judge each of their claims.

    Exit code 1: not all hold; 3: runs failed.
    """
    from deploy.run.workers import workers  # noqa: PLC0415
    from deploy.study import reproduction  # noqa: PLC0415
    from deploy.study.results import open_results  # noqa: PLC0415

    settings = {"seed": list(range(seeds))} if seeds is not None else {}
    found = reproduction.requested(claim or [], quick=quick, settings=settings)
    runs = out / reproduction.RUNS
    with stopping(runs), open_results(runs) as results:
        with counting(errors, "reproduce") as report:
            done = reproduction.reproduce(
                found, results, workers(jobs, scheduler), report, quick=quick, retry=retry
            )
        command = ["murmur reproduce", *(claim or []), *(["--quick"] if quick else [])]
        command += [f"--seeds {seeds}"] if seeds is not None else []
        pages = reproduction.write(done, out, " ".join(command), style)
    parts = [part for each in done.claims for part in each.parts]
    for part in parts:
        report_failures(part.failures)
    print_table(reproduction.overview(done))
    screen.print(f"Results: {', '.join(map(str, pages))}" + (" (quick)" if quick else ""))
    end_study([cause for part in parts for cause in part.failures], 0 if done.all_hold else 1)


@app.command()
@setting_flags("map", "seed", "bus")
@figure_flags
def compare(
    scenario: Annotated[
        list[Path] | None, argument("A.toml B.toml ...", "scenarios to compare, or one with a flag below")
    ] = None,
    strategies: Annotated[str | None, option("A,B,...", "strategies to compare")] = None,
    map_encodings: Annotated[str | None, option("A,B,...", "map encodings to compare")] = None,
    radios: Annotated[str | None, option("A,B,...", "radio presets to compare")] = None,
    map_: Annotated[list[str] | None, option("FILE|NAME", "on this map; repeatable", name="--map")] = None,
    seeds: Annotated[int, option("N", "run the seeds 0 to N - 1", min=2, max=MAX_RUNS)] = 10,
    metric: Annotated[
        str, option("NAME", "key of summary.json to compare, as bytes.total (docs/reference/files.md)")
    ] = "steps",
    set_: SetOption = None,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    out: Annotated[Path, option("DIR", "folder for pictures, means and runs")] = Path("comparison"),
    *,
    settings: dict[str, Any],
    style: Any,
) -> None:
    """Compare scenarios, strategies, map encodings or radios on the same seeds, with confidence intervals.

    With one scenario file, all strategies, map encodings, or radios have its settings.

    Exit code 3: runs failed.
    """
    from deploy.study import comparison  # noqa: PLC0415

    settings |= other_settings(set_ or [], comparison.compare, settings)
    choices = [
        ("strategy", "strategies", strategies), ("map_encoding", "map-encodings", map_encodings),
        ("radio", "radios", radios),
    ]  # fmt: skip
    given = [(key, names(text, flag, ())) for key, flag, text in choices if text is not None]
    files = scenario or []
    if len(given) > 1 or not (given or files) or (given and len(files) > 1):
        raise ValueError(
            "give either scenario files, --strategies, --map-encodings or --radios, or one scenario file and one of "
            "these flags"
        )
    if twice := [key for key, _ in given if key in settings]:
        raise ValueError(f"{twice[0]} = {settings[twice[0]]!r}: is compared; remove this flag")
    compared: Any = files or [{key: name} for key, values in given for name in values]
    if files and given:
        compared = comparison.varied(files[0], *given[0])
    if map_:
        settings["map"] = map_ if len(map_) > 1 else map_[0]
    runs = out / "runs.parquet"
    with stopping(runs):
        done = comparison.compare(
            compared, seeds=seeds, metric=metric, jobs=jobs, scheduler=scheduler, out=runs, **settings
        )
        report_sweep(done.sweep)
        for sentence in done.verdicts:
            screen.print(f"{sentence}.")
        files = done.write(out, style)
    screen.print(f"Results: {out} (start with {files[0]} and {files[1]})")
    end_study(done.sweep.failures)


@app.command()
@setting_flags("map", "robots", "range", "bandwidth", "finish", "seed", "bus")
@figure_flags
def size(
    map_: Annotated[str, option("FILE|NAME", "the building", name="--map")] = "office",
    robots: Annotated[str, option("2..8|2,4", "numbers of robots to try")] = "2..8",
    radio: Annotated[
        str | None, option("NAME,...", f"radio presets to try, for a team each: {', '.join(PRESETS)}")
    ] = None,
    bandwidth: Annotated[
        str | None,
        option("BYTES,...", f"bandwidths to try, in bytes per step (default {','.join(BANDWIDTHS)})"),
    ] = None,
    range_: Annotated[
        str | None, option("METERS|P%,...", f"ranges to try (default {','.join(RANGES)})", name="--range")
    ] = None,
    deadline: Annotated[
        int | None, option("STEPS", "longest time that an exploration may take (default: any)", min=1)
    ] = None,
    min_map_accuracy: Annotated[
        float, option("SHARE", "smallest share of the building that a map must show correctly", min=0, max=1)
    ] = 0.95,
    finish: Annotated[str, option("all|first", "robots that must finish with such a map")] = "all",
    seeds: Annotated[int, option("N", "runs of each combination", min=1, max=MAX_RUNS)] = 5,
    set_: SetOption = None,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    out: Annotated[Path, option("DIR", "folder for curves, the table and runs")] = Path("size"),
    *,
    settings: dict[str, Any],
    style: Any,
) -> None:
    """Find the smallest team, bandwidth and range that are sufficient for a building, or a team for each radio.

    Exit code 1: none of them is sufficient; 3: runs failed.
    """
    if any(text.startswith("recording") for text in set_ or []):
        raise ValueError(
            "recording: murmur size lets teams explore a building; for a log, compare radios instead: murmur compare "
            "SCENARIO.toml --radios lora-sf9,zigbee (docs/recorded.md)"
        )
    common: dict[str, Any] = {
        "robots": whole_numbers(robots, "robots", MAX_ROBOTS), "deadline": deadline, "finish": finish,
        "min_map_accuracy": min_map_accuracy, "seeds": seeds, "jobs": jobs, "scheduler": scheduler,
        "out": out / "runs.parquet",
    }  # fmt: skip
    if radio is not None:
        if bandwidth is not None or range_ is not None:
            raise ValueError(f"radio = {radio!r}: sets bandwidth and range; omit --bandwidth and --range")
        size_radios(map_, names(radio, "radio", ()), out, set_ or [], settings, common, style)
        return
    from deploy.study import sizing  # noqa: PLC0415

    settings |= other_settings(set_ or [], sizing.size, settings)
    with stopping(common["out"]):
        done = sizing.size(
            map_,
            bandwidth=[
                int(item) if item.isdecimal() else item
                for item in names(bandwidth, "bandwidth", BANDWIDTHS)
            ],
            range=names(range_, "range", RANGES), **common, **settings,
        )  # fmt: skip
        report_sweep(done.sweep)
        screen.print(done.sentence)
        files = done.write(out, style)
    screen.print(f"Results: {out} (start with {files[0]})")
    end_study(done.sweep.failures, 0 if done.enough is not None else 1)


def size_radios(
    map_: str,
    radios: list[str],
    out: Path,
    texts: list[str],
    settings: dict[str, Any],
    common: dict[str, Any],
    style: Any,
) -> None:
    """Find the smallest team for each radio, and print the table."""
    from deploy.study import radio_sizing  # noqa: PLC0415

    settings |= other_settings(texts, radio_sizing.size_radios, settings)
    with stopping(common["out"]):
        done = radio_sizing.size_radios(map_, radios, **common, **settings)
        report_failures(done.failures)
        print_table(done.lines)
        for sentence in done.sentences:
            screen.print(sentence)
        files = done.write(out, style)
    screen.print(f"Results: {out} (start with {files[0]})")
    end_study(done.failures, 0 if any(answer.is_enough for answer in done.answers) else 1)
