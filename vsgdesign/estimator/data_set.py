"""The data that networks are trained on, with what they were measured on: windows and cycles, splits, and files."""

from __future__ import annotations

import hashlib
import itertools
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.files import check_file_target, staged_file
from vsgdesign.equations.field import FieldAnswer, FieldSettings
from vsgdesign.errors import ArtifactError, Fault, StudyError
from vsgdesign.study.given_files import WINDOWS_BYTES, check_unpacked, open_given

Array = NDArray[np.float64]
Arrays = dict[str, NDArray[Any]]
Index = NDArray[np.int64]

SCHEMA = 2
SHARES = (0.70, 0.15, 0.15)
"""Of training, validation and test, as in the paper."""
SPLITS = ("by_scenario", "published_split")

_WHAT = "a data set of windows"

REASONS = ("no operating point", "bridge voltage", "current", "voltage limits", "unstable")
"""Why a draw of a scenario cannot be run: the columns of ``redrawn``."""

CHANGES = ("none", "jump", "jump_and_step", "grid_step", "power_step")
"""What may happen in a run: nothing; another impedance; another impedance with a step of the grid's voltage, phase or
frequency; such a step alone; a step of the references. The index is the code in ``change``."""

_COLUMN = {name: k for k, name in enumerate(FieldAnswer._fields)}


@dataclass(frozen=True)
class Split:
    """Rows of a data set for training, validation and test, each in increasing order."""

    training: Index
    validation: Index
    test: Index


@dataclass(frozen=True, kw_only=True)
class Rows:
    """N rows of arrays of equal length, and a header in JSON's types that says what they are."""

    no_such_data: ClassVar[str]
    """What a file is that lacks an array."""

    header: Mapping[str, Any]
    """Recipe (all fields), seed and what the rows were made on, in JSON's types."""

    @classmethod
    def array_names(cls) -> list[str]:
        """Names of the arrays, in the file's order."""
        return [field.name for field in fields(cls) if field.name != "header"]

    @classmethod
    def fit(cls, header: Mapping[str, Any], arrays: Arrays) -> str:  # noqa: ARG003 - for those that look
        """What is wrong with arrays of the right names and lengths; empty: nothing."""
        return ""

    @property
    def arrays(self) -> Arrays:
        """The arrays by name, in the file's order."""
        return {name: getattr(self, name) for name in self.array_names()}

    def __len__(self) -> int:
        return len(next(iter(self.arrays.values())))

    @property
    def hash(self) -> str:
        """SHA-256 of header and every array."""
        return content_hash(self.header, self.arrays)

    def split_by(self, units: NDArray[Any], word: str, seed: int) -> Split:
        """70/15/15 at random of the different ``units`` (N,), whose rows stay together.

        Raises StudyError where too few of them leave a part empty.
        """
        names = np.random.default_rng(seed).permutation(np.unique(units))
        return Split(*(np.flatnonzero(np.isin(units, part)) for part in parts_of(names, word)))


D = TypeVar("D", bound=Rows)


@dataclass(frozen=True, kw_only=True)
class DataSet(Rows):
    """N windows, SI. Every array has N rows. At rest a window obeys :eq:`window-phasors`.

    The header has the recipe (all fields), seed, hash of the converter, channels, sampling and ratings.
    """

    no_such_data: ClassVar[str] = "is not a data set of windows"

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

    @classmethod
    def fit(cls, header: Mapping[str, Any], arrays: Arrays) -> str:  # noqa: ARG003
        """Whether the windows are a matrix."""
        return "" if arrays["windows"].ndim == 2 else f"{cls.no_such_data}: array shapes."

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
        if kind == "by_scenario":
            return self.split_by(self.scenario, "scenarios", seed)
        return self.split_by(np.arange(len(self)), "windows", seed)


@dataclass(frozen=True, kw_only=True)
class FieldCycles(Rows):
    """N cycles of the field estimator: the recursions' quantities in each. Every array has N rows.

    The header has ``recipe``, ``seed``, names of the ``features``, ``converters``, and the ``settings`` of each one's
    estimator.
    """

    no_such_data: ClassVar[str] = "holds no runs of the field estimator"

    features: Array
    """(N, n): what the network is given."""
    answer: Array
    """(N, 14): the recursions' answer, fields of FieldAnswer. It is held while they are in doubt."""
    refuted: NDArray[np.bool_]
    """Whether the step after the event refutes that the impedance moved."""
    truth: Array
    """(N, 2): true R_g in Ω and L_g in H in the middle of the cycle."""
    run: NDArray[np.int64]
    converter: NDArray[np.int64]
    """Index into the header's ``converters`` and ``settings``."""
    t_s: Array
    """End of the cycle, s."""
    change: NDArray[np.int64]
    """The last change before the end of the cycle, a code of CHANGES; 0 before the first."""
    change_number: NDArray[np.int64]
    """Which change of its run this was; −1 before the first."""
    since_change: Array
    """Time since it, s; infinite before the first."""
    factor: Array
    """By which factor |Z_g| became larger or smaller with that change, at least 1."""
    current: Array
    """The current just before that change, pu of the rated peak."""
    broken: NDArray[np.bool_]
    """Whether the run was broken off because it diverged."""

    @classmethod
    def fit(cls, header: Mapping[str, Any], arrays: Arrays) -> str:
        """Whether they are of this version of the field estimator."""
        fits = all(set(one) == set(FieldSettings._fields) for one in header.get("settings", [{}]))
        if fits and arrays["answer"].shape[1:] == (len(FieldAnswer._fields),):
            return ""
        return "holds runs of another version of the field estimator. Make them again."

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the features."""
        return tuple(self.header["features"])

    def said(self, name: str) -> Array:
        """(N,): a field of the recursions' answer."""
        return self.answer[:, _COLUMN[name]]

    @property
    def mode(self) -> NDArray[np.int64]:
        """(N,): LEARN, TRACK or DOUBT."""
        return self.said("mode").astype(np.int64)

    def settings(self, converter: int) -> FieldSettings:
        """The settings of the estimator of a converter."""
        return FieldSettings(**self.header["settings"][converter])

    @property
    def targets(self) -> Array:
        """(N, 2): y = ln(Z/Ẑ), logarithm of the size and difference of the angles in rad.

        Z goes from the measured voltage to the grid's source, at nominal frequency (:eq:`field-posterior`).
        """
        y = np.zeros((len(self), 2))
        for k in range(len(self.header["converters"])):
            one = self.settings(k)
            rows = np.flatnonzero(self.converter == k)
            behind = complex(one.R_2, one.X_2)
            pair = (self.truth[rows], np.column_stack([self.said("R_g"), self.said("L_g")])[rows])
            true, held = (R_L @ (1.0 / one.Z_base, 1j * one.omega_n / one.Z_base) + behind for R_L in pair)
            ratio = np.log(true / np.where(np.abs(held) < 1e-3, 1e-3, held))
            y[rows, 0], y[rows, 1] = np.real(ratio), np.imag(ratio)
        return y

    def split(self, seed: int = 0) -> Split:
        """70/15/15 at random by run: all cycles of a run are in one part.

        Raises StudyError if there are too few runs.
        """
        return self.split_by(self.run, "runs", seed)

    def rows(self, chosen: NDArray[Any]) -> FieldCycles:
        """Some of the cycles."""
        return replace(self, **{name: values[chosen] for name, values in self.arrays.items()})


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


def content_hash(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> str:
    """SHA-256 of a header and of the names, types, shapes and bytes of arrays."""
    digest = hashlib.sha256(_header_text(header).encode())
    for name, values in arrays.items():
        digest.update(f"{name} {values.dtype.str} {values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def write_data_set(path: str | Path, data: Rows) -> None:
    """As npz with header and hash; whole or not at all. Raises ArtifactError where it cannot be written."""
    write_arrays(path, data.header, data.arrays)


def read_data_set(path: str | Path) -> DataSet:
    """Windows from their file. Raises ArtifactError for a file that is none, is of another schema or was changed."""
    return read_rows(path, DataSet)


def read_rows(path: str | Path, kind: type[D]) -> D:
    """Data of some kind from their file. Raises ArtifactError as :func:`read_data_set` does."""
    header, arrays = read_arrays(path)
    missing = [name for name in kind.array_names() if name not in arrays]
    if missing or len({len(values) for values in arrays.values()}) != 1:
        raise ArtifactError(f'"{path}" {kind.no_such_data}: {", ".join(missing) or "array shapes"}.')
    if problem := kind.fit(header, arrays):
        raise ArtifactError(f'"{path}" {problem}')
    return kind(**{name: arrays[name] for name in kind.array_names()}, header=header)


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
        with open_given(path, WINDOWS_BYTES) as stream:
            check_unpacked(stream, WINDOWS_BYTES)
            data = np.load(stream, allow_pickle=False)
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
