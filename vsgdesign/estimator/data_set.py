"""Windows with what they were measured on, their splits, and their file."""

from __future__ import annotations

import hashlib
import itertools
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.files import check_file_target, staged_file
from vsgdesign.errors import ArtifactError, Fault, StudyError

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SCHEMA = 2
SHARES = (0.70, 0.15, 0.15)
"""Of training, validation and test, as in the paper."""
SPLITS = ("by_scenario", "published_split")

_WHAT = "a data set of windows"

_NUMBERS = ("R_g", "L_g", "P", "Q", "V_rms", "V_g_rms", "omega_g", "source_phase", "t_s")
_ARRAYS = ("windows", "scenario", "after_change", *_NUMBERS, "redrawn")

REASONS = ("no operating point", "bridge voltage", "current", "voltage limits", "unstable")
"""Why a draw of a scenario cannot be run: the columns of ``redrawn``."""


@dataclass(frozen=True)
class Split:
    """Rows of a data set for training, validation and test, each in increasing order."""

    training: Index
    validation: Index
    test: Index


@dataclass(frozen=True, kw_only=True)
class DataSet:
    """N windows, SI. Every array has N rows. At rest a window obeys :eq:`window-phasors`."""

    windows: Array
    """(N, 2·C·n): n samples of each of C voltage components (V), then of C current components (A), as measured.
    ``phase_a``: v_a(1…n), i_a(1…n). Two components: v_α, v_β, i_α, i_β, or d and q."""
    scenario: Index
    """Which run a window is of: windows of one run are alike."""
    after_change: NDArray[np.bool_]
    """Whether the run's change (of references or grid) came before the window."""
    R_g: Array
    L_g: Array
    """The grid during the window, Ω and H: what is to be estimated."""
    P: Array
    Q: Array
    V_rms: Array
    """The power loops' quantities at the end of the window: W, var, phase rms V."""
    V_g_rms: Array
    omega_g: Array
    source_phase: Array
    """Angle of the grid source's space vector at the first sample, rad; −π/2 where synchronised as published."""
    t_s: Array
    """End of the window in its run, s."""
    redrawn: Index
    """(N, len(REASONS)): draws that were thrown away before the one that this window's scenario is of, by reason."""
    header: Mapping[str, Any]
    """Recipe (all fields), seed, hash of the converter, channels, sampling and ratings, in JSON's types."""

    def __len__(self) -> int:
        return len(self.windows)

    @property
    def targets(self) -> Array:
        """(N, 2): L_g in mH, R_g in Ω, the published network's outputs in their order."""
        return np.column_stack([self.L_g * 1e3, self.R_g])

    @property
    def channels(self) -> str:
        """``phase_a``, ``alpha_beta`` or ``dq``."""
        return str(self.header["recipe"]["channels"])

    @property
    def sample_interval(self) -> float:
        """Spacing of the samples, s."""
        return float(self.header["recipe"]["sample_interval"])

    @property
    def samples(self) -> int:
        """Samples of a window, n."""
        return int(self.header["recipe"]["samples"])

    @property
    def synchronised(self) -> bool:
        """Whether windows are synchronised with the grid's phase, which no converter knows."""
        return bool(self.header["synchronised"])

    @property
    def hash(self) -> str:
        """SHA-256 of header and every array."""
        return content_hash(self.header, arrays_of(self))

    @property
    def draws(self) -> dict[str, Any]:
        """How the scenarios came about: ``scenarios``, ``draws`` of all, and those ``thrown_away`` by reason."""
        _, first = np.unique(self.scenario, return_index=True)
        counts = self.redrawn[first].sum(axis=0).tolist()
        thrown = {reason: count for reason, count in zip(REASONS, counts, strict=True) if count}
        return {"scenarios": len(first), "draws": len(first) + sum(counts), "thrown_away": thrown}

    def split(self, kind: str = "by_scenario", seed: int = 0) -> Split:
        """70/15/15 at random. ``by_scenario`` keeps every run in one part; ``published_split`` draws windows.

        Raises StudyError for another kind, or where too few scenarios or windows leave a part empty.
        """
        if kind not in SPLITS:
            raise StudyError("split", [Fault("split", f'"{kind}"', "must be one of " + ", ".join(SPLITS))])
        units = self.scenario if kind == "by_scenario" else np.arange(len(self))
        names = np.random.default_rng(seed).permutation(np.unique(units))
        parts = parts_of(names, "scenarios" if kind == "by_scenario" else "windows")
        return Split(*(np.flatnonzero(np.isin(units, part)) for part in parts))


def parts_of(names: NDArray[Any], field: str) -> list[NDArray[Any]]:
    """Names of scenarios or runs, in their order, as parts for training, validation and test."""
    check_enough(len(names), field)
    return np.split(names, _ends(len(names)))


def check_enough(count: int, field: str) -> None:
    """Before they are made: raises StudyError where so many scenarios or runs cannot be split in three parts."""
    if not _splits(count):
        least = next(enough for enough in itertools.count(1) if _splits(enough))
        problem = f"too few to be split 70/15/15 for training, validation and test (least: {least})"
        raise StudyError("split", [Fault(field, str(count), problem, "Ask for more.")])


def _ends(count: int) -> NDArray[np.int_]:
    return np.round(np.cumsum(SHARES) * count).astype(int)[:2]


def _splits(count: int) -> bool:
    first, second = _ends(count)
    return 0 < first < second < count


def arrays_of(data: DataSet) -> dict[str, NDArray[Any]]:
    """The arrays by name, in the file's order."""
    return {name: getattr(data, name) for name in _ARRAYS}


def content_hash(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> str:
    """SHA-256 of a header and of the names, types, shapes and bytes of arrays."""
    digest = hashlib.sha256(_header_text(header).encode())
    for name, values in arrays.items():
        digest.update(f"{name} {values.dtype.str} {values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def write_data_set(path: str | Path, data: DataSet) -> None:
    """As npz with header and hash; whole or not at all. Raises ArtifactError where it cannot be written."""
    write_arrays(path, data.header, arrays_of(data))


def read_data_set(path: str | Path) -> DataSet:
    """Back from its file. Raises ArtifactError for a file that is none, is of another schema or was changed."""
    header, arrays = read_arrays(path)
    missing = [name for name in _ARRAYS if name not in arrays]
    rows = {len(values) for values in arrays.values()}
    if missing or len(rows) != 1 or arrays["windows"].ndim != 2:
        raise ArtifactError(f'"{path}" is not a data set of windows: {", ".join(missing) or "array shapes"}.')
    return DataSet(**{name: arrays[name] for name in _ARRAYS}, header=header)


def write_arrays(path: str | Path, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Arrays, a header and the hash of both as one npz, whole or not at all; only an unchanged one is replaced."""
    text = _header_text({"schema": SCHEMA, "hash": content_hash(header, arrays), "header": header})
    with staged_file(path, _WHAT, _is_unchanged) as place, place.open("wb") as stream:
        np.savez(stream, allow_pickle=False, header=np.frombuffer(text.encode(), dtype=np.uint8), **arrays)


def check_data_target(path: str | Path) -> None:
    """Before the long work rather than after it: raises ArtifactError where :func:`write_arrays` would."""
    check_file_target(path, _WHAT, _is_unchanged)


def _is_unchanged(path: Path) -> bool:
    try:
        read_arrays(path)
    except ArtifactError:
        return False
    return True


def read_arrays(path: str | Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Header and arrays of :func:`write_arrays`. Raises ArtifactError, also where a byte of the content changed."""
    try:
        # Opened here: NumPy leaves a file that turns out to be no archive open.
        with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            arrays = {name: data[name] for name in data.files}
        document = json.loads(arrays.pop("header").tobytes().decode())
        schema, said, header = document["schema"], document["hash"], document["header"]
    except (OSError, ValueError, KeyError, TypeError, NotImplementedError, zipfile.BadZipFile, EOFError) as error:
        raise ArtifactError(f'"{path}" is not a readable data set: {error}') from error
    if schema != SCHEMA:
        raise ArtifactError(f'"{path}" has schema {schema}; this version reads {SCHEMA}. Generate it again.')
    if said != content_hash(header, arrays):
        raise ArtifactError(f'"{path}" was changed since it was written (its hash does not fit). Generate it again.')
    return header, arrays


def _header_text(header: Mapping[str, Any]) -> str:
    return json.dumps(header, sort_keys=True, separators=(",", ":"), allow_nan=False)
