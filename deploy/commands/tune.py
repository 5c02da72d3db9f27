"""`murmur tune`: search for the weights of a strategy on training seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from deploy.commands.console import errors, screen
from deploy.commands.flag_values import named_values, names, whole_numbers
from deploy.commands.flags import argument, command_family, option
from deploy.commands.study_flags import JobsOption, SchedulerOption, SetOption
from deploy.commands.study_output import print_table, stopping
from deploy.scenario.tables import MAX_RUNS
from deploy.study.progress import counting

app = command_family()

RUNS, TRIALS, RECORD = "runs.parquet", "trials.csv", "weights.toml"
"""Files in the folder of results."""


@app.command()
def tune(
    strategy: Annotated[str, argument("STRATEGY", "a name from `murmur strategies`")] = "repairmen",
    maps: Annotated[
        str | None, option("A,B,...", "generators or map files (default: one generator per kind)")
    ] = None,
    seeds: Annotated[str, option("0..4|0,3", "training seeds of the search")] = "0..2",
    check_seeds: Annotated[str, option("5..9|5,7", "training seeds on which the result is checked")] = "3..5",
    evaluations: Annotated[
        int, option("N", "weights to try, the default ones included", min=1, max=10_000)
    ] = 20,
    weights: Annotated[str | None, option("A,B,...", "options to search (default: all weights)")] = None,
    search_seed: Annotated[int, option("S", "seed of the search's order", min=0)] = 0,
    set_: SetOption = None,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    out: Annotated[Path, option("DIR", "folder for runs, trials and weights")] = Path("tune"),
) -> None:
    """Search for the weights of a strategy by runs on training seeds; the same command continues.

    The score of weights is their steps over those of the default weights. Test seeds are rejected. Exit code 3: runs
    failed.
    """
    from deploy.run.workers import workers  # noqa: PLC0415
    from deploy.study import tuning  # noqa: PLC0415
    from deploy.study.results import open_results, write_table  # noqa: PLC0415
    from worldsim.atomic_files import write_whole  # noqa: PLC0415

    search = tuning.Search(
        strategy=strategy,
        maps=names(maps, "maps", tuning.MAPS),
        seeds=whole_numbers(seeds, "seeds", MAX_RUNS),
        check_seeds=whole_numbers(check_seeds, "check_seeds", MAX_RUNS),
        evaluations=evaluations,
        only=names(weights, "weights", ()),
        search_seed=search_seed,
        settings=named_values(set_ or [], "set", "robots=6"),
    )
    search.check()
    with stopping(out / RUNS), open_results(out / RUNS) as results:
        with counting(errors, "tune", announce=True) as report:
            done = tuning.tune(search, results, workers(jobs, scheduler), report)
        write_table(done.table, out / TRIALS)
        write_whole(out / RECORD, lambda file: file.write(done.record.encode()))
    print_table(done.lines)
    screen.print(done.sentence)
    screen.print(f"Results: {out} (start with {out / TRIALS} and {out / RECORD})")
