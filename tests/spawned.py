"""A plugin of pytest for `make test-spawn`: as on Windows, nothing is forked and no text is UTF-8 by itself."""

from __future__ import annotations

import locale
import multiprocessing
import os
import sys

multiprocessing.set_start_method("spawn")
if hasattr(os, "fork"):
    del os.fork  # whatever would fork ends with an error
if sys.platform != "win32" and locale.getencoding().casefold().replace("-", "") == "utf8":
    raise SystemExit("set PYTHONUTF8=0 LC_ALL=C: where texts are UTF-8 by themselves, a missing encoding shows nowhere")
