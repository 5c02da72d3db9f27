"""Run chaos cases in memory, repeat some as processes, and shrink failing ones."""

from __future__ import annotations

import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from deploy.chaos.byzantine import HostileRadios
from deploy.chaos.case import ChaosCase, case
from deploy.chaos.cut_connections import Cut, Cutter, proxied
from deploy.chaos.false_maps import with_false_map
from deploy.chaos.invariants import InvariantChecker, InvariantError
from deploy.record.summary import digest
from deploy.run import launch
from deploy.run.in_memory import MemoryRun
from deploy.run.rendezvous import on_loopback
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan

AS_PROCESSES_EVERY = 10
"""One of this many cases is repeated as processes."""


@dataclass(frozen=True)
class Verdict:
    """The result of a case."""

    case: ChaosCase
    failure: str
    """The violated invariant or the error; empty if all invariants hold."""
    digest: str = ""
    steps: int = 0
    wall_s: float = 0.0
    """Duration of the run in memory."""
    known: float = 0.0
    """Share of the reachable cells that the living robots know at the end."""
    as_processes: bool = False
    """Whether the case was repeated as processes."""

    @property
    def line(self) -> str:
        """Case and result in one line of text."""
        case, scenario = self.case, self.case.scenario
        hostile = f", byzantine robots {list(case.byzantine)}" if case.byzantine else ""
        hostile += f", damaged frames to robots {list(case.flipped)}" if case.flipped else ""
        hostile += ", a false map of robot {}: {}".format(*case.false_map) if case.false_map else ""
        hostile += f", long messages of robots {list(case.heavy)}" if case.heavy else ""
        hostile += f", {len(case.cuts)} cut connections" if self.as_processes else ""
        return (
            f"seed {case.seed}: {scenario.robots} robots on {scenario.map}, {scenario.strategy}, "
            f"{scenario.map_encoding}, {scenario.dissemination}, {len(scenario.fault)} faults{hostile}: "
            f"{self.steps} steps, known {self.known:.3f}, digest {self.digest[:12]}"
        )


def run_case(drawn: ChaosCase, *, as_processes: bool = False) -> Verdict:
    """Run a case in memory with all checks; with `as_processes` repeat it and compare the digests."""
    plan = plans.make(drawn.scenario)
    if drawn.false_map is not None:
        plan = with_false_map(plan, *drawn.false_map)
    lying = drawn.false_map[0] if drawn.false_map is not None else None
    checker = InvariantChecker(plan, drawn.byzantine, lying, damaged=bool(drawn.flipped))
    radios = HostileRadios(drawn.seed, drawn.byzantine, drawn.flipped, drawn.heavy)
    began = time.perf_counter()
    try:
        run = MemoryRun(plan, wrap=radios)
        for step in run.steps():
            for agent in run.agents:
                if agent.robot is not None and not agent.done:
                    checker.check(step, agent.robot)
        checker.check_end(run.records)
    except InvariantError as violation:
        return Verdict(drawn, str(violation))
    except Exception as error:  # any error is a finding
        frame = traceback.extract_tb(error.__traceback__)[-1]
        return Verdict(drawn, f"{type(error).__name__}: {error} ({frame.filename}:{frame.lineno})")
    found, wall_s = digest(run.records), time.perf_counter() - began
    failure = _run_as_processes(plan, radios, drawn.cuts, found) if as_processes else ""
    return Verdict(drawn, failure, found, run.records.step, wall_s, checker.known, as_processes)


def run_cases(first: int, runs: int) -> Iterator[Verdict]:
    """Run the cases of the seeds `first` to `first + runs - 1`."""
    for seed in range(first, first + runs):
        yield run_case(case(seed), as_processes=seed % AS_PROCESSES_EVERY == 0)


def shrink(verdict: Verdict) -> Verdict:
    """Remove faults from a failing case as long as it still fails, in whichever way."""
    for candidate in verdict.case.smaller():
        found = run_case(candidate, as_processes=verdict.as_processes)
        if found.failure:
            return shrink(found)
    return verdict


def _run_as_processes(plan: Plan, radios: HostileRadios, cuts: Sequence[Cut], expected: str) -> str:
    """Repeat a run as processes, and cut connections; return a failure, or nothing."""
    cut_robots = sorted({cut.robot for cut in cuts})
    with proxied(on_loopback(plan.scenario.robots), cut_robots) as (rendezvous, proxies):
        cutter = Cutter(cuts, proxies)
        with cutter.running():
            outcome = launch.run(plan, None, cutter.watch, rendezvous=rendezvous, wrap=radios)
    if outcome.deaths:
        return f"as processes: {outcome.deaths}"
    found = digest(outcome.records)
    return "" if found == expected else f"as processes the digest is {found[:12]}, not {expected[:12]}"
