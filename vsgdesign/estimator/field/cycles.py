"""What the field estimator's network is trained on: the recursions' quantities in every cycle of many runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.field import FieldAnswer, FieldSettings
from vsgdesign.errors import ArtifactError
from vsgdesign.estimator.data_set import Split, content_hash, parts_of, read_arrays, write_arrays

Array = NDArray[np.float64]

CHANGES = ("none", "jump", "jump_and_step", "grid_step", "power_step")
"""What may happen in a run: nothing; another impedance; another impedance with a step of the grid's voltage, phase or
frequency; such a step alone; a step of the references. The index is the code in ``change``."""

_ARRAYS = (
    "features",
    "answer",
    "refuted",
    "truth",
    "run",
    "converter",
    "t_s",
    "change",
    "change_number",
    "since_change",
    "factor",
    "current",
    "broken",
)
_COLUMN = {name: k for k, name in enumerate(FieldAnswer._fields)}


@dataclass(frozen=True, kw_only=True)
class FieldCycles:
    """N cycles. Every array has N rows."""

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
    header: Mapping[str, Any]
    """``recipe``, ``seed``, names of the ``features``, ``converters``, and the ``settings`` of each one's estimator."""

    def __len__(self) -> int:
        return len(self.features)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the features."""
        return tuple(self.header["features"])

    @property
    def hash(self) -> str:
        """SHA-256 of header and every array."""
        return content_hash(self.header, arrays_of(self))

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
        names = np.random.default_rng(seed).permutation(np.unique(self.run))
        return Split(*(np.flatnonzero(np.isin(self.run, part)) for part in parts_of(names, "runs")))

    def rows(self, chosen: NDArray[Any]) -> FieldCycles:
        """Some of the cycles."""
        return FieldCycles(**{name: values[chosen] for name, values in arrays_of(self).items()}, header=self.header)


def arrays_of(cycles: FieldCycles) -> dict[str, NDArray[Any]]:
    """The arrays by name, in the file's order."""
    return {name: getattr(cycles, name) for name in _ARRAYS}


def write_cycles(path: str | Path, cycles: FieldCycles) -> None:
    """As npz with header and hash; whole or not at all. Raises ArtifactError where it cannot be written."""
    write_arrays(path, cycles.header, arrays_of(cycles))


def read_cycles(path: str | Path) -> FieldCycles:
    """Back from its file. Raises ArtifactError for a file that is none or was changed."""
    header, arrays = read_arrays(path)
    missing = [name for name in _ARRAYS if name not in arrays]
    if missing or len({len(values) for values in arrays.values()}) != 1:
        raise ArtifactError(f'"{path}" holds no runs of the field estimator: {", ".join(missing) or "array shapes"}.')
    settings = header.get("settings", [{}])
    fits = all(set(one) == set(FieldSettings._fields) for one in settings)
    if not fits or arrays["answer"].shape[1:] != (len(FieldAnswer._fields),):
        raise ArtifactError(f'"{path}" holds runs of another version of the field estimator. Make them again.')
    return FieldCycles(**{name: arrays[name] for name in _ARRAYS}, header=header)
