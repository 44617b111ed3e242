"""What a reader of recorded waveforms gives: columns by name, and which of them are no voltage of a phase."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class RecordError(Exception):
    """What is wrong with a file, in one or several sentences: (field of [replay], problem, advice) each."""

    def __init__(self, *faults: tuple[str, str, str]) -> None:
        super().__init__("; ".join(problem for _, problem, _ in faults))
        self.faults = faults


class Columns(NamedTuple):
    """The columns of a file, in its unit or, if it says one, in V."""

    values: dict[str, Array]
    rate: float | None = None
    """Samples in a second, if the file says it."""
    times: Array | None = None
    """Times of the samples in s, if the file has them in place of a rate."""
    voltages: tuple[str, ...] | None = None
    """Columns that are voltages of a phase by their unit; None if the file has no units."""
    unfit: Mapping[str, tuple[str, str]] = MappingProxyType({})
    """Columns that cannot be one, each with the problem and the advice."""


_VOLT = {"": 1.0, "k": 1e3, "m": 1e-3, "M": 1e6, "K": 1e3, "u": 1e-6, "µ": 1e-6, "\u03bc": 1e-6}
_UNIT = re.compile(r"([kKmMuµ\u03bc]?)(?:[vV]|[vV]olts?|VOLTS?)")
_NO_UNIT = {"", "-", "1", "none", "pu", "p.u.", "p.u", "per unit", "%"}


def volts_of(unit: str) -> float | None:
    """V for one of a unit; 1 where there is none or it is relative, and None for a unit of something else."""
    text = unit.strip()
    found = _UNIT.fullmatch(text)
    if found:
        return _VOLT[found.group(1)]
    return 1.0 if text.lower() in _NO_UNIT else None


def says_volts(unit: str) -> bool:
    """Whether a unit is one of voltages."""
    return _UNIT.fullmatch(unit.strip()) is not None


def unfit_unit(name: str, unit: str) -> tuple[str, str]:
    """Why a column of another unit is no voltage."""
    return f'"{name}" is in "{unit.strip()}", which is no unit of a voltage', "Choose voltages, phase to neutral."
