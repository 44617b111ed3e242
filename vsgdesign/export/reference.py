"""A reference run of a wrapper: inputs that turn as a grid does, with a step and a dip, and what comes out."""

from __future__ import annotations

import ctypes
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.equations.frames import clarke, clarke_inverse
from vsgdesign.export.wrapping import LINUX, Builder, Wrapped

SAMPLES = 400
"""Of a reference run: at the start at rest, then a step of a set point, and a dip of the voltage."""


def reference_inputs(one: Wrapped) -> np.ndarray:
    """Inputs of every sample, (SAMPLES, inputs). The plant is not part of it: what is measured is given."""
    ports, unit = one.ports.inputs, one.unit
    rows = np.tile([port.start for port in ports], (SAMPLES, 1))
    at = {port.name: k for k, port in enumerate(ports)}
    turn = np.exp(1j * unit.omega_n * unit.T_s * np.arange(SAMPLES))
    turn[SAMPLES // 2 :] *= 0.7
    for name in ("v", "i_s", "i_g", "v_grid"):
        if f"{name}_a" in at:
            k = at[f"{name}_a"]
            vector = complex(*clarke(*rows[0, k : k + 3])) * turn
            rows[:, k : k + 3] = np.column_stack(clarke_inverse(vector.real, vector.imag))
    if "P" in at:
        rows[:, at["P"]] *= np.abs(turn)
    rows[SAMPLES // 4 :, at["P_ref"]] += 0.1 * unit.S_rated
    return rows


def reference_csv(one: Wrapped, builder: Builder) -> tuple[str, str] | None:
    """Inputs and outputs of the reference run as CSV; None without a compiler. The outputs of a row are those of the
    sample that took its inputs, and stand one sample later, as a co-simulation gives them."""
    library = builder.library(one.unit, {}, LINUX, "vsg_*")
    if library is None:
        return None
    given = reference_inputs(one)
    outputs = run_library(library, one, given)
    T_s = one.unit.T_s
    first = np.array([port.start for port in one.ports.outputs])
    told = np.vstack([first, outputs])
    return (
        _csv([port.name for port in one.ports.inputs], given, T_s),
        _csv([port.name for port in one.ports.outputs], told, T_s),
    )


def run_library(library: bytes, one: Wrapped, given: np.ndarray) -> np.ndarray:
    """What the functions of a variant in a compiled library answer to a series of inputs."""
    with tempfile.TemporaryDirectory(prefix="vsg") as folder:
        place = Path(folder) / "library.so"
        place.write_bytes(library)
        loaded = ctypes.CDLL(str(place))
        state = ctypes.create_string_buffer(1 << 16)
        parameters = np.array([port.start for port in one.ports.parameters])
        outputs = np.empty((len(given), len(one.ports.outputs)))
        getattr(loaded, f"vsg_{one.word}_begin")(state, _pointer(parameters))
        step = getattr(loaded, f"vsg_{one.word}_step")
        for row, out in zip(np.ascontiguousarray(given), outputs, strict=True):
            step(state, _pointer(row), _pointer(parameters), _pointer(out))
    return outputs


def _pointer(array: np.ndarray) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def _csv(names: list[str], rows: np.ndarray, T_s: float) -> str:
    lines = [",".join(["time", *names])]
    for k, row in enumerate(rows):
        lines.append(",".join([repr(k * T_s), *map(repr, map(float, row))]))
    return "\n".join([*lines, ""])
