"""The impedance of a grid as it was measured over frequency: read from CSV, with R and L at the nominal frequency.

A file has a row for each frequency. It gives the impedance of the positive and perhaps of the negative sequence, or the
four impedances in a dq frame that turns at the nominal frequency. What a resistance and an inductance in series cannot
say of it is said in words.
"""

from __future__ import annotations

import csv
import io
import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import Fault, StudyError
from vsgdesign.study.datasheet.reading import Entry, Sheet
from vsgdesign.study.given_files import RESULT_BYTES, read_given

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

BAND = 0.4, 2.5
"""Share of the nominal frequency from which on, and up to which, R and L are fitted."""

CLOSE = 0.1
"""A measured point is that of R and L if it differs from them by less than this share of its own size."""

ADVICE = (
    "Give one row for each frequency: a column f in Hz, and for each impedance two columns in ohm, such as Z+_re and "
    "Z+_im, or Zdd_re, Zdd_im, Zdq_re, … Zqq_im; or _abs and _deg in place of _re and _im."
)

_NAMES = {"+": "p", "pos": "p", "positive": "p", "p": "p", "-": "n", "−": "n", "neg": "n", "negative": "n", "n": "n"}
_PARTS = {"re": "re", "real": "re", "im": "im", "imag": "im", "abs": "abs", "mag": "abs", "deg": "deg", "rad": "rad"}
_PARTS |= {"arg": "deg", "phase": "deg", "angle": "deg", "magnitude": "abs"}
_DQ = ("dd", "dq", "qd", "qq")


@dataclass(frozen=True, kw_only=True)
class MeasuredImpedance:
    """The impedance of a grid at its terminals, in the sequences of the three phases."""

    source: str
    f_hz: Array
    """Frequencies of the positive sequence, ascending (n,)."""
    Z: Complex
    """Its impedance, Ω (n,)."""
    negative: tuple[Array, Complex] | None = None
    """The same of the negative sequence."""
    notes: tuple[str, ...] = ()
    """How the file was read, where that was not obvious, and what was seen in it."""


@dataclass(frozen=True, kw_only=True)
class SeriesFit:
    """R and L in series in place of a measured impedance."""

    measured: MeasuredImpedance
    f_n: float
    """Nominal frequency, Hz."""
    R: float
    """Ω."""
    L: float
    """H."""
    error: float
    """Largest distance of a fitted point from R and L, over its own size."""
    points: int
    """Fitted points."""
    explained_hz: tuple[float, float]
    """From where to where every measured point is that of R and L, within CLOSE of its own size."""
    resonance_hz: float | None
    """The first frequency above the nominal one at which the impedance turns from inductive to capacitive, or back."""

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was found, and what R and L cannot say."""
        f, one = self.measured.f_hz, self.measured
        low, high = self.explained_hz
        X = 2.0 * math.pi * self.f_n * self.L
        found = [
            f"R = {self.R:.4g} ohm and L = {1e3 * self.L:.4g} mH at {self.f_n:g} Hz (X/R = {X / self.R:.3g}), from "
            f"{self.points} points between {BAND[0] * self.f_n:g} and {BAND[1] * self.f_n:g} Hz, which they meet "
            f"within {100.0 * self.error:.2g} %. A study says it as grid = "
            f'{{ R_g = "{self.R:.4g} ohm", L_g = "{1e3 * self.L:.4g} mH" }}.'
        ]
        if high < f[-1]:
            found.append(
                f"R and L in series say the impedance within {100.0 * CLOSE:g} % from {low:.4g} to {high:.4g} Hz, and "
                f"not above: it was measured up to {f[-1]:.4g} Hz."
            )
        if self.resonance_hz is not None:
            found.append(f"The first resonance is at {self.resonance_hz:.4g} Hz. R and L have none.")
        return (*found, *one.notes)


def read_impedance(path: str | Path, f_n: float) -> MeasuredImpedance:
    """Reads the CSV of a measured impedance. ``f_n`` (Hz) is the frequency at which a dq frame turns.

    Raises StudyError with every fault of the file.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise _error(path, "is a folder", ADVICE)
        text = read_given(path, RESULT_BYTES).decode("utf-8-sig", errors="replace")
    except OSError as error:
        raise _error(path, error.strerror or "cannot be read", ADVICE) from None
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise _error(path, "is empty", ADVICE)
    separator = max(";\t,", key=lines[0].count)
    rows = list(csv.reader(io.StringIO("\n".join(lines)), delimiter=separator))
    columns = _columns(path, rows[0])
    values = _values(path, rows, columns, comma=separator != ",")
    f = values[:, columns["f"]]
    if (bad := np.flatnonzero(~(f > 0.0))).size:
        raise _error(path, f"row {bad[0] + 2}: f = {f[bad[0]]:g} Hz", "Frequencies are above 0 Hz.")
    order = np.argsort(f, kind="stable")
    f, values = f[order], values[order]
    if (twice := np.flatnonzero(np.diff(f) == 0.0)).size:
        raise _error(path, f"f = {f[twice[0]]:g} Hz stands there twice", "Give each frequency once.")
    found = {name: _complex(values, columns, name) for name in ("p", "n", *_DQ) if _has(columns, name)}
    for name in ("p", "n", "dd", "qq"):
        if name in found and (bad := np.flatnonzero(found[name] == 0.0)).size:
            raise _error(path, f"f = {f[bad[0]]:g} Hz: an impedance is zero", "Leave out what was not measured.")
    if "p" in found:
        negative = None if "n" not in found else (f, found["n"])
        return MeasuredImpedance(source=str(path), f_hz=f, Z=found["p"], negative=negative, notes=_apart(found, f))
    return _from_dq(path, f, found, f_n)


def _from_dq(path: Path, f: Array, found: dict[str, Complex], f_n: float) -> MeasuredImpedance:
    """The sequences that a frame sees at f: the positive one at f + f_n and at f − f_n, and below f_n the negative one
    at f_n − f, as its conjugate."""
    along, across = 0.5 * (found["dd"] + found["qq"]), 0.5 * (found["qd"] - found["dq"])
    notes = []
    if float(np.median(across.real)) < 0.0:  # a reactance rises with the frequency
        across = -across
        notes.append("The q axis of the file lags the d axis: its coupling was taken with the other sign.")
    mirror = np.hypot(np.abs(0.5 * (found["dd"] - found["qq"])), np.abs(0.5 * (found["dq"] + found["qd"])))
    share = float(np.max(mirror / np.hypot(np.abs(along), np.abs(across))))
    if share > CLOSE:
        notes.append(
            f"Up to {100.0 * share:.2g} % of the impedance couples the frequencies f_n + f and f_n - f (Zdd is not "
            "Zqq, or Zdq is not -Zqd). R and L do not: there is another converter close by, or the grid is unbalanced."
        )
    upper, lower, below, above = along + 1j * across, along - 1j * across, f < f_n, f > f_n
    positive = np.concatenate([f + f_n, f[above] - f_n]), np.concatenate([upper, lower[above]])
    order = np.argsort(positive[0], kind="stable")
    back = np.argsort(f_n - f[below], kind="stable")
    return MeasuredImpedance(
        source=str(path),
        f_hz=positive[0][order],
        Z=positive[1][order],
        negative=((f_n - f[below])[back], np.conj(lower[below])[back]),
        notes=tuple(notes),
    )


def _apart(found: dict[str, Complex], f: Array) -> tuple[str, ...]:
    """A note where both sequences differ."""
    if "n" not in found:
        return ()
    share = np.abs(found["n"] - found["p"]) / np.abs(found["p"])
    worst = int(np.argmax(share))
    if share[worst] <= CLOSE:
        return ()
    return (
        f"Z- differs from Z+ by up to {100.0 * share[worst]:.2g} % (at {f[worst]:.4g} Hz). Those of lines and "
        "transformers are equal: there is another converter or a machine close by.",
    )


def fit_series(measured: MeasuredImpedance, f_n: float) -> SeriesFit:
    """R and L by least squares over the points around the nominal frequency (Hz), each relative to its own size.

    The negative sequence of a passive grid has the same impedance, and takes part. Raises StudyError where there are
    fewer than two frequencies around the nominal one, and where the grid is not inductive there.
    """
    sets = [(measured.f_hz, measured.Z), *([measured.negative] if measured.negative is not None else [])]
    f = np.concatenate([one for one, _ in sets])
    Z = np.concatenate([one for _, one in sets])
    near = (f >= BAND[0] * f_n) & (f <= BAND[1] * f_n)
    path = Path(measured.source)
    if len(np.unique(f[near])) < 2:
        raise _error(
            path,
            f"{int(near.sum())} point between {BAND[0] * f_n:g} and {BAND[1] * f_n:g} Hz; it has {f.min():.4g} to "
            f"{f.max():.4g} Hz",
            f"R and L are those at {f_n:g} Hz: measure at two frequencies around it or more.",
        )
    weight = 1.0 / np.abs(Z[near])
    omega = 2.0 * math.pi * f[near]
    # Real and imaginary part of R + jωL share nothing, so each is a mean of its own.
    R = float(np.sum(weight**2 * Z[near].real) / np.sum(weight**2))
    L = float(np.sum(weight**2 * omega * Z[near].imag) / np.sum((weight * omega) ** 2))
    if not (R > 0.0 and L > 0.0):
        raise _error(
            path,
            f"R = {R:.4g} ohm and L = {1e3 * L:.4g} mH at {f_n:g} Hz",
            "A grid has both above zero: check the signs, the unit and the frame of the file.",
        )
    error = float(np.max(np.abs(Z[near] - R - 1j * omega * L) * weight))
    away = np.abs(measured.Z - R - 2j * math.pi * measured.f_hz * L) > CLOSE * np.abs(measured.Z)
    return SeriesFit(
        measured=measured,
        f_n=f_n,
        R=R,
        L=L,
        error=error,
        points=int(near.sum()),
        explained_hz=_around(measured.f_hz, away, f_n),
        resonance_hz=_resonance(measured, f_n),
    )


def with_impedance(sheet: Sheet, fit: SeriesFit) -> Sheet:
    """A datasheet with the fitted impedance as that of its grids."""
    X = 2.0 * math.pi * fit.f_n * fit.L
    size = Entry("grid_impedance", f"{math.hypot(fit.R, X):.6g} ohm", "", "measured impedance")
    ratio = Entry("x_over_r", f"{X / fit.R:.6g}", "", "measured impedance")
    return replace(sheet, entries=(*sheet.entries, size, ratio))


def _around(f: Array, away: NDArray[np.bool_], f_n: float) -> tuple[float, float]:
    """The frequencies on both sides of the nominal one up to which no point is away."""
    above, below = f[away & (f > f_n)], f[away & (f < f_n)]
    low = f[0] if not below.size else f[f > below[-1]][0]
    high = f[-1] if not above.size else f[f < above[0]][-1] if (f < above[0]).any() else f[0]
    return float(low), float(high)


def _resonance(measured: MeasuredImpedance, f_n: float) -> float | None:
    f, X = measured.f_hz, measured.Z.imag
    turns = np.flatnonzero((X[:-1] * X[1:] < 0.0) & (f[1:] > f_n))
    if not turns.size:
        return None
    k = int(turns[0])
    return float(f[k] + (f[k + 1] - f[k]) * X[k] / (X[k] - X[k + 1]))


def _columns(path: Path, head: list[str]) -> dict[str, int]:
    """Where each column is, by names such as ``f``, ``p re`` and ``dq im``."""
    found: dict[str, int] = {}
    for k, text in enumerate(head):
        plain = re.sub(r"[\[(][^\])]*[\])]", " ", text).strip().casefold()
        if plain in ("f", "freq", "frequency", "f_hz", "frequency_hz", "f hz"):
            found["f"] = k
            continue
        match = re.fullmatch(r"(?:(re|im|abs|arg)[ _]+)?z_?([a-z]+|[+−-])(?:[ _.]*([a-z]+?)(?:[ _]?ohm)?)?", plain)
        if match is None:
            continue
        name = _NAMES.get(match[2], match[2])
        part = _PARTS.get(match[1] or match[3] or "")
        if name in ("p", "n", *_DQ) and part is not None:
            found[f"{name} {part}"] = k
    faults = []
    if "f" not in found:
        faults.append(Fault("f", ", ".join(head)[:200], "there is no column of the frequency", "Call it f, in Hz."))
    there = [name for name in ("p", "n", *_DQ) if _has(found, name)]
    if not ("p" in there or all(name in there for name in _DQ)):
        faults.append(Fault("Z", ", ".join(head)[:200], "there is neither Z+ nor Zdd, Zdq, Zqd and Zqq", ADVICE))
    if faults:
        raise StudyError(str(path), faults)
    return found


def _has(columns: dict[str, int], name: str) -> bool:
    pairs = (("re", "im"), ("abs", "deg"), ("abs", "rad"))
    return any(all(f"{name} {part}" in columns for part in pair) for pair in pairs)


def _values(path: Path, rows: list[list[str]], columns: dict[str, int], *, comma: bool) -> Array:
    faults, found = [], []
    width = max(columns.values()) + 1
    for number, row in enumerate(rows[1:], 2):
        try:
            if len(row) < width:
                raise ValueError(f"has {len(row)} columns, and the heading {len(rows[0])}")
            used = columns.values()
            texts = [one.replace(",", ".") if comma else one for one in row[:width]]
            values = [float(one) if k in used else 0.0 for k, one in enumerate(texts)]
            if not all(map(math.isfinite, values)):
                raise ValueError("has a value that is not finite")
            found.append(values)
        except ValueError as error:
            faults.append(Fault(f"row {number}", _shown(row), str(error), "Give a number in every column."))
    if not found and not faults:
        faults.append(Fault("file", "", "has a heading and no row", ADVICE))
    if faults:
        raise StudyError(str(path), faults[:20])
    return np.array(found)


def _shown(row: list[str]) -> str:
    """A row as a message shows it."""
    return ", ".join(row)[:80]


def _complex(values: Array, columns: dict[str, int], name: str) -> Complex:
    def of(part: str) -> Array:
        return np.asarray(values[:, columns[f"{name} {part}"]])

    if f"{name} re" in columns:
        return np.asarray(of("re") + 1j * of("im"), dtype=np.complex128)
    angle = np.deg2rad(of("deg")) if f"{name} deg" in columns else of("rad")
    return np.asarray(of("abs") * np.exp(1j * angle), dtype=np.complex128)


def _error(path: Path, problem: str, advice: str) -> StudyError:
    return StudyError(str(path), [Fault("impedance", f'"{path}"', problem, advice)])
