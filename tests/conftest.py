"""For every test."""

from __future__ import annotations

import signal

# A shell that starts a job in the background makes it ignore SIGINT, and every process of it: tests of interruptions
# would wait for nothing.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
