"""For every test."""

from __future__ import annotations

import signal

from hypothesis import settings

# The same examples in every run, and no deadline: a machine that is busy is no fault of the code.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

# A shell that starts a job in the background makes it ignore SIGINT, and every process of it: tests of interruptions
# would wait for nothing.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
