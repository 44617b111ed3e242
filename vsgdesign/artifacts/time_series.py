"""Time series as files: every logged sample in npz, a readable thinned copy and tables in CSV, and COMTRADE (IEEE
C37.111, IEC 60255-24), which tools for fault records read.
"""

from __future__ import annotations

import csv
import datetime
import math
import re
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import ArtifactError
from vsgdesign.study.given_files import RECORD_BYTES, check_unpacked, open_given

Array = NDArray[np.float64]

UNITS = {
    "t_s": "s", "v_pcc_a": "V", "v_pcc_b": "V", "v_pcc_c": "V", "i_pcc_a": "A", "i_pcc_b": "A", "i_pcc_c": "A",
    "P_pcc": "W", "Q_pcc": "var", "omega": "rad/s", "V_rms": "V", "delta": "rad", "R_g": "ohm", "L_g": "H",
    "R_g_hat": "ohm", "L_g_hat": "H", "R_g_deviation": "ohm", "L_g_deviation": "H", "status": "1",
    "cov_RL": "ohm*H", "sigma": "1", "valid": "1", "changed": "1", "event": "1", "doubt": "1", "mode": "1",
    "amplitude": "1", "foreign": "1", "passive": "1",
    "v_dc": "V", "P_dc": "W", "E_source": "J", "E_bridge": "J", "dc_charge": "1", "dc_p": "W", "dc_target": "W",
    "dc_stored": "J", "dc_u": "V", "P_cut": "W",
    "K_ip": "rad/(s2*W)", "D_p": "W*s/rad", "K_iq": "V/(s*var)", "D_q": "var/V",
    "K_pq": "rad/(s2*var)", "K_qp": "V/(s*W)", "k_P": "rad/(s*W)", "k_Q": "rad/(s*var)",
}  # fmt: skip
"""Unit of every series by name."""


def write_npz(path: str | Path, series: Mapping[str, Array]) -> None:
    """All samples. Time in double precision, everything else in single (a relative error of 6e-8)."""
    arrays = {name: values if name == "t_s" else values.astype(np.float32) for name, values in series.items()}
    np.savez(path, allow_pickle=False, **arrays)


def read_npz(path: str | Path) -> dict[str, Array]:
    """The series back, in double precision. Raises ArtifactError for a file that is not one."""
    try:
        # Opened here: NumPy leaves a file that turns out to be no archive open.
        with open_given(path, RECORD_BYTES) as stream:
            check_unpacked(stream, RECORD_BYTES)
            data = np.load(stream, allow_pickle=False)
            return {name: np.asarray(data[name], dtype=float) for name in data.files}
    except (OSError, ValueError, TypeError, NotImplementedError, zipfile.BadZipFile, EOFError) as error:
        raise ArtifactError(f'"{path}" is not a readable time series: {error}') from error


def write_csv(path: str | Path, series: Mapping[str, Array], interval_s: float) -> None:
    """Every ``interval_s`` one row (every sample if that is shorter), one column a series, units in the header."""
    t_s = series["t_s"]
    step = max(round(interval_s / (t_s[1] - t_s[0])), 1) if len(t_s) > 1 else 1
    header = ",".join(f"{name} [{UNITS[name]}]" for name in series)
    columns = [_texts(name, np.array(values[::step], dtype=float)) for name, values in series.items()]
    row = ",".join(form for form, _ in columns) + "\n"
    with Path(path).open("w", encoding="utf-8", newline="\n") as stream:
        stream.write(header + "\n")
        stream.writelines(row % values for values in zip(*(values for _, values in columns), strict=True))


def _texts(name: str, values: Array) -> tuple[str, list[Any]]:
    """A column as numbers and their format; one that mostly stands still as text, of which every piece is made once."""
    # Time keeps more digits: at 100 s, seven no longer tell samples of 50 us apart.
    form = "%.12g" if name == "t_s" else "%.7g"
    bits = values.view(np.int64)  # -0 is not 0
    starts = np.flatnonzero(np.append(True, bits[1:] != bits[:-1])[: len(values)])
    if 2 * len(starts) > len(values):
        return form, values.tolist()
    lengths = np.diff(starts, append=len(values)).tolist()
    pieces = [[form % value] * length for value, length in zip(values[starts].tolist(), lengths, strict=True)]
    return "%s", list(chain.from_iterable(pieces))


def write_table(path: str | Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """One header line with units, then the rows; numbers to nine digits, what is not finite as an empty cell."""
    with Path(path).open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.9g}" if math.isfinite(value) else ""
    return "" if value is None else str(value)


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
