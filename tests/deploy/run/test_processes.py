"""Scheduling policy of a run's processes, tested in a separate process."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
import os
import threading
from deploy.run.processes import schedule_as_batch

schedule_as_batch()
policies = [os.sched_getscheduler(0)]
thread = threading.Thread(target=lambda: policies.append(os.sched_getscheduler(0)))
thread.start()
thread.join()
print(*policies)
"""


@pytest.mark.skipif(not hasattr(os, "SCHED_BATCH"), reason="the system has no such policy")
def test_batch_policy_applies_to_the_process_and_its_threads() -> None:
    command = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)

    assert done.stdout.split() == [str(os.SCHED_BATCH)] * 2
