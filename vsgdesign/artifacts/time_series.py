"""Time series as files, every logged sample in npz and a readable thinned copy in CSV; and tables as CSV."""

from __future__ import annotations

import csv
import math
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

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
