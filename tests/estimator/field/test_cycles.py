"""The file of runs: it comes back as it was, and what is of another version or another kind is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.estimator.field.made_up import made_up_cycles
from vsgdesign.errors import ArtifactError
from vsgdesign.estimator.data_set import FieldCycles, read_rows, write_arrays, write_data_set


def test_round_trip(tmp_path: Path) -> None:
    cycles = made_up_cycles(4)
    write_data_set(tmp_path / "runs.npz", cycles)
    back = read_rows(tmp_path / "runs.npz", FieldCycles)
    assert back.hash == cycles.hash
    assert np.array_equal(back.targets, cycles.targets)


def test_other_files_are_refused(tmp_path: Path) -> None:
    cycles = made_up_cycles(4)
    settings = [{name: value for name, value in cycles.header["settings"][0].items() if name != "R_2"}]
    write_data_set(tmp_path / "old.npz", replace(cycles, header={**cycles.header, "settings": settings}))
    with pytest.raises(ArtifactError, match=r"another version of the field estimator\. Make them again"):
        read_rows(tmp_path / "old.npz", FieldCycles)
    arrays = {name: values for name, values in cycles.arrays.items() if name != "truth"}
    write_arrays(tmp_path / "less.npz", cycles.header, arrays)
    with pytest.raises(ArtifactError, match="holds no runs of the field estimator: truth"):
        read_rows(tmp_path / "less.npz", FieldCycles)


def test_targets_are_the_logarithm_of_the_ratio() -> None:
    """By hand, with the filter's grid side on both."""
    cycles = made_up_cycles(3)
    one = cycles.settings(0)
    behind = complex(one.R_2, one.X_2) * one.Z_base
    true = complex(cycles.truth[30, 0], one.omega_n * cycles.truth[30, 1]) + behind
    held = complex(cycles.said("R_g")[30], one.omega_n * cycles.said("L_g")[30]) + behind
    assert cycles.targets[30] == pytest.approx([np.log(abs(true) / abs(held)), np.angle(true / held)], abs=1e-12)
