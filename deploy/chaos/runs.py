"""Running storms: in memory, some of them again as processes; and finding out what a failure needs."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from deploy.chaos.byzantine import Lies
from deploy.chaos.case import ChaosCase, case
from deploy.chaos.invariants import Violation, Watcher
from deploy.record.summary import digest
from deploy.run import launch
from deploy.run.in_memory import MemoryRun
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan

AGAIN_EVERY = 10
"""So many runs in memory, and one of them again as processes."""


@dataclass(frozen=True)
class Verdict:
    """What came of a storm: what went wrong, if anything did, and what was seen of it."""

    case: ChaosCase
    failure: str
    digest: str = ""
    steps: int = 0
    wall_s: float = 0.0
    known: float = 0.0
    again: bool = False
    """Whether it was run again as processes."""

    @property
    def line(self) -> str:
        """What was run, and what came of it, in a line."""
        this, map_id = self.case, self.case.scenario
        byzantine = f", liars {list(this.byzantine)}" if this.byzantine else ""
        return (
            f"seed {this.seed}: {map_id.robots} robots on {map_id.map}, {map_id.strategy}, {map_id.map_encoding} by "
            f"{map_id.dissemination}, {len(map_id.fault)} faults{byzantine}: {self.steps} steps, known {self.known:.3f}, "
            f"digest {self.digest[:12]}"
        )


def weather(drawn: ChaosCase, *, again: bool = False) -> Verdict:
    """Run a storm in memory and check it; with `again` as processes as well, whose digest must be the same."""
    plan = plans.make(drawn.scenario)
    watcher = Watcher(plan, drawn.byzantine)
    lies = Lies(drawn.seed, drawn.byzantine)
    began = time.perf_counter()
    try:
        under_way = MemoryRun(plan, wrap=lies)
        for step in under_way.steps():
            for agent in under_way.agents:
                if agent.robot is not None and not agent.done:
                    watcher.inspect(step, agent.robot)
        records = under_way.records
        watcher.conclude(records)
    except Violation as violation:
        return Verdict(drawn, str(violation))
    except Exception as error:  # whatever it is, it is a finding
        where = traceback.extract_tb(error.__traceback__)[-1]
        return Verdict(drawn, f"{type(error).__name__}: {error} ({where.filename}:{where.lineno})")
    found, wall_s = digest(records), time.perf_counter() - began
    failure = _as_processes(plan, lies, found) if again else ""
    return Verdict(drawn, failure, found, records.step, wall_s, watcher.known, again)


def storms(first: int, runs: int) -> Iterator[Verdict]:
    """Run the storms of seeds `first` to `first + runs - 1`."""
    for seed in range(first, first + runs):
        yield weather(case(seed), again=seed % AGAIN_EVERY == 0)


def shrink(verdict: Verdict, tell: Callable[[ChaosCase], object] = lambda _: None) -> Verdict:
    """Leave out of a storm that fails what it does not need in order to fail; any failure counts."""
    smaller = True
    while smaller:
        smaller = False
        for less in verdict.case.smaller():
            tell(less)
            found = weather(less, again=verdict.again)
            if found.failure:
                verdict, smaller = found, True
                break
    return verdict


def _as_processes(plan: Plan, lies: Lies, expected: str) -> str:
    outcome = launch.run(plan, None, wrap=lies)
    if outcome.deaths:
        return f"as processes: {outcome.deaths}"
    found = digest(outcome.records)
    return "" if found == expected else f"as processes the digest is {found[:12]}, not {expected[:12]}"
