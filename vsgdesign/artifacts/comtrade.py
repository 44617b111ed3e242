"""Time series as COMTRADE (IEEE C37.111, IEC 60255-24), which tools for fault records read."""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.time_series import UNITS
from vsgdesign.errors import ArtifactError

Array = NDArray[np.float64]

FORMS = ("ascii", "binary", "float32", "cff")
"""Of the samples: whole numbers of five digits, of 16 bits, floats of 32 bits, and these in a single file."""

_STEPS = {"ascii": 99_998, "binary": 32_767}
"""Largest whole number; the next one says that a value is missing."""

_MISSING = {"ascii": 99_999, "binary": -32_768}
_BEGIN = datetime.datetime(2000, 1, 1)  # a run has no date, and equal runs have equal files
_MOST_TICKS = 2**32 - 2


class _Scaled(NamedTuple):
    """A series as the file counts it: its value is a n + b."""

    a: float
    b: float
    counted: NDArray[np.generic]


def write_comtrade(
    path: str | Path,
    series: Mapping[str, Array],
    form: str,
    *,
    f_n: float,
    station: str,
    trigger_s: float,
    units: Mapping[str, str] = UNITS,
) -> list[Path]:
    """``path``.cfg and ``path``.dat, or ``path``.cff, with every sample of all series; ``t_s`` gives the sampling rate.

    ``form`` is one of :data:`FORMS`, and ``units`` has the unit of every series. What is not finite is missing in
    the file. ``trigger_s``: the time that the record is about, s. Returns what was written. Raises ArtifactError for an
    unknown form and for fewer than two samples.
    """
    t_s, count = series["t_s"], len(series["t_s"])
    if form not in FORMS:
        raise ArtifactError(f'comtrade: "{form}" is no form of COMTRADE. Known: {", ".join(FORMS)}.')
    if count < 2:
        raise ArtifactError(f"comtrade: a record has two samples or more, and the run has {count}.")
    names = [name for name in series if name != "t_s"]
    scaled = [_scaled(series[name], form) for name in names]
    rate = float(f"{(count - 1) / (t_s[-1] - t_s[0]):.10g}")
    multiple = 1 if 1e6 * count / rate < _MOST_TICKS else 1000
    ticks = np.rint(np.arange(count) * (1e6 / (rate * multiple))).astype(np.uint32)
    whole = form in _STEPS
    head = [f"{_plain(station)},vsgdesign,{1999 if whole else 2013}", f"{len(names)},{len(names)}A,0D"]
    for k, (name, one) in enumerate(zip(names, scaled, strict=True)):
        most = repr(float(np.finfo(np.float32).max)) if not whole else str(_STEPS[form])
        phase = name[-1].upper() if re.search(r"_[abc]$", name) else ""
        head.append(f"{k + 1},{name},{phase},,{units[name]},{one.a!r},{one.b!r},0,-{most},{most},1,1,P")
    head += [f"{f_n:g}", "1", f"{rate:.10g},{count}", _stamp(float(t_s[0])), _stamp(max(trigger_s, float(t_s[0])))]
    head += [{"cff": "FLOAT32"}.get(form, form.upper()), str(multiple), *([] if whole else ["0,0", "F,3"])]
    cfg = "".join(f"{line}\r\n" for line in head).encode("ascii", errors="replace")
    dat = _rows(ticks, [one.counted for one in scaled], form)
    if form == "cff":
        parts = (b"CFG", cfg), (b"INF", b"\r\n"), (b"HDR", b"\r\n"), (b"DAT FLOAT32: %d" % len(dat), dat)
        found = {f"{path}.cff": b"".join(b"--- file type: %s ---\r\n%s" % part for part in parts)}
    else:
        found = {f"{path}.cfg": cfg, f"{path}.dat": dat}
    for name, content in found.items():
        Path(name).write_bytes(content)
    return list(map(Path, found))


def _scaled(values: Array, form: str) -> _Scaled:
    values = np.asarray(values, dtype=float)
    finite = np.isfinite(values)
    if form not in _STEPS:
        return _Scaled(1.0, 0.0, np.where(finite, values, np.nan).astype("<f4"))
    known = values[finite] if finite.any() else np.zeros(1)
    low, high = float(known.min()), float(known.max())
    b = 0.5 * (low + high)
    a = 0.5 * (high - low) / _STEPS[form] or 1.0
    counted = np.full(len(values), _MISSING[form], dtype=np.int64)
    counted[finite] = np.rint((values[finite] - b) / a)
    return _Scaled(a, b, counted)


def _rows(ticks: NDArray[np.uint32], columns: list[NDArray[np.generic]], form: str) -> bytes:
    numbers = np.arange(1, len(ticks) + 1)
    if form == "ascii":
        table = np.column_stack([numbers, ticks, *columns])
        return "".join(",".join(map(str, row)) + "\r\n" for row in table.tolist()).encode("ascii")
    kind = "<i2" if form == "binary" else "<f4"
    rows = np.zeros(len(ticks), dtype=[("n", "<u4"), ("t", "<u4"), ("v", kind, (len(columns),))])
    rows["n"], rows["t"] = numbers, ticks
    for k, column in enumerate(columns):
        rows["v"][:, k] = column
    return rows.tobytes()


def _stamp(t_s: float) -> str:
    """A time of the run as a date, to the microsecond."""
    moment = _BEGIN + datetime.timedelta(microseconds=round(1e6 * t_s) if math.isfinite(t_s) else 0)
    return moment.strftime("%d/%m/%Y,%H:%M:%S.%f")


def _plain(text: str) -> str:
    return re.sub(r"[,\r\n]+", " ", text)[:64]
