"""What all tests share: how long hypothesis searches, and where the real maps are.

Hypothesis tries 30 examples a property by default; ``MURMUR_HYPOTHESIS=thorough`` makes it thousands. The
examples of a default run are the same each time.
"""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "default", max_examples=30, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile(
    "thorough", max_examples=3000, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile(os.environ.get("MURMUR_HYPOTHESIS", "default"))

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Tests that run in the background of a shell would hand down to what they start that it ignores Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def real_maps() -> Path:
    """The folder of the real maps; where it is missing the test is skipped."""
    folder = Path(os.environ.get("MURMUR_MAPS", Path(__file__).parents[2] / "shared" / "maps"))
    if not folder.is_dir():
        pytest.skip(f"no folder {folder}: set MURMUR_MAPS to the folder of the real maps")
    return folder
