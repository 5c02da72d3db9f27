"""What the entry points of a run's processes ask of the system, in a process of its own."""

import os
import subprocess
import sys

import pytest

TURN = """
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
def test_who_waits_for_a_turn_interrupts_nobody_nor_do_its_threads() -> None:
    command = [sys.executable, "-c", TURN]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)

    assert done.stdout.split() == [str(os.SCHED_BATCH)] * 2
