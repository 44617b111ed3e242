"""Memory that is kept for a while goes back."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import gc, os
import numpy as np
from vsgdesign.execution.executors import give_memory_back, keep_memory

def resident():
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE")

before = resident()
for step in (keep_memory, give_memory_back):
    step()
    np.ones(3_000_000)
    print(gc.get_freeze_count() > 0, (resident() - before) // 1_000_000)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="another system's memory is not kept")
def test_memory_is_kept_until_it_is_given_back() -> None:
    """An array of 24 MB that has been dropped is still there, and then no more."""
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    (kept, there), (later, left) = (line.split() for line in done.stdout.splitlines())
    assert (kept, later) == ("True", "False")
    assert int(there) > 20
    assert int(left) < 12
