"""Observe a run from outside: speed, processor time of this process, memory of the robots' processes."""

from __future__ import annotations

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deploy.record.records import Records


class Sample(NamedTuple):
    """Step, wall-clock time, and processor time of this process in seconds, at one moment of a run."""

    step: int
    wall_s: float
    processor_s: float


class Observer:
    """Samples a run; pass `observe` to the functions that run a plan."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        """The samples since the first step."""
        self.memory_mb = 0.0
        """Median memory of the robots' processes at the first step; 0 without processes."""
        self._began = time.perf_counter()

    def observe(self, records: Records) -> None:
        """Take a sample, once the run has reached its first step."""
        if not records.step:
            return
        if not self.samples:
            self.memory_mb = robot_memory_mb()
        self.samples.append(Sample(records.step, time.perf_counter(), time.process_time()))

    @property
    def first_step_s(self) -> float:
        """Seconds from the creation of the observer to the first step."""
        return self.samples[0].wall_s - self._began

    @property
    def steps_per_s(self) -> float:
        """Steps per second between the first and the last sample."""
        steps, wall_s, _ = self._span()
        return steps / wall_s

    @property
    def processor_ms_per_step(self) -> float:
        """Processor time of this process per step, in milliseconds."""
        steps, _, processor_s = self._span()
        return 1000 * processor_s / steps

    def _span(self) -> Sample:
        """The difference of the last sample and the first."""
        if not self.samples or self.samples[0].step == self.samples[-1].step:
            raise ConnectionError("the benchmark's run ended before it could be measured")
        first, last = self.samples[0], self.samples[-1]
        return Sample(
            last.step - first.step, last.wall_s - first.wall_s, last.processor_s - first.processor_s
        )


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
