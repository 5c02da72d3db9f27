"""Observe a run from outside: its speed, counters that grow with its steps, and the memory of its processes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deploy.record.records import Records


@dataclass(frozen=True)
class Sample:
    """Step, wall-clock time in seconds, and counters at one moment of a run."""

    step: int
    wall_s: float
    counters: dict[str, float]


class Observer:
    """Samples a run; pass `observe` to the functions that run a plan.

    Parameters
    ----------
    counters : callable
        Returns counters by name.
    processes : bool
        Whether to measure the memory of the robots' processes, once.

    Attributes
    ----------
    samples : list of Sample
        The samples since the first step.
    memory_mb : float
        Median memory of the robots' processes; 0 if it was not measured.
    """

    def __init__(self, counters: Callable[[], dict[str, float]] = dict, *, processes: bool = False) -> None:
        self.samples: list[Sample] = []
        self.memory_mb = 0.0
        self._began = time.perf_counter()
        self._counters = counters
        self._processes = processes

    def observe(self, records: Records) -> None:
        """Take a sample, once the run has reached its first step."""
        if not records.step:
            return
        self.samples.append(Sample(records.step, time.perf_counter(), self._counters()))
        if self._processes and not self.memory_mb:
            self.memory_mb = robot_memory_mb()

    @property
    def first_step_s(self) -> float:
        """Seconds from the creation of the observer to the first step."""
        return self.samples[0].wall_s - self._began

    @property
    def steps_per_s(self) -> float:
        """Steps per second between the first and the last sample."""
        first, last = self._ends()
        return (last.step - first.step) / (last.wall_s - first.wall_s)

    @property
    def per_step(self) -> dict[str, float]:
        """Growth of each counter per step."""
        first, last = self._ends()
        steps = last.step - first.step
        return {
            name: (last.counters[name] - count) / steps
            for name, count in first.counters.items()
            if name in last.counters
        }

    def _ends(self) -> tuple[Sample, Sample]:
        if not self.samples or self.samples[0].step == self.samples[-1].step:
            raise ConnectionError("the benchmark's run ended before it could be measured")
        return self.samples[0], self.samples[-1]


def robot_memory_mb() -> float:
    """Median proportional set size of the robots' processes in MB; 0 if the system does not report it."""
    sizes = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            title = (folder / "cmdline").read_bytes()
            if title.startswith(b"murmur r") and title[8:9].isdigit():
                lines = (folder / "smaps_rollup").read_text().splitlines()
                sizes += [int(line.split()[1]) / 1000 for line in lines if line.startswith("Pss:")]
        except OSError:
            continue
    return float(np.median(sizes)) if sizes else 0.0
