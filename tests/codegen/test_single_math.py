"""The printed sine, cosine and angle: right to single precision, and the same bits however they are compiled."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.compilers import GCC_AND_CLANG, require_compiler
from vsgdesign.codegen.c99 import TYPES
from vsgdesign.codegen.vector_math import SINGLE
from vsgdesign.export.c_code import filled
from vsgdesign.export.compiled import run_compiler
from vsgdesign.export.laws import printed_math

RNG = np.random.default_rng(11)
ANGLES = np.concatenate(
    [RNG.uniform(-7.0, 7.0, 400), RNG.uniform(-6000.0, 6000.0, 200), np.arange(-8, 9) * (0.5 * np.pi), [0.0]]
).astype(np.float32)
AXES = [-2.0, -1.0, 0.0, 1.0, 2.0]
VECTORS = np.concatenate(
    [RNG.normal(0.0, 300.0, (400, 2)), [[y, x] for y in AXES for x in AXES], RNG.normal(0.0, 1e-6, (50, 2))]
).astype(np.float32)


def values(found: dict[str, Any], real: type) -> dict[str, np.ndarray]:
    """Every function on its arguments."""
    one, two = ANGLES.astype(real), VECTORS.astype(real)
    told = {name: [found[name](x) for x in one] for name in ("sin", "cos")}
    told |= {name: [found[name](y, x) for y, x in two] for name in ("atan2", "hypot")}
    return {name: np.array(list_, dtype=real) for name, list_ in told.items()}


def test_they_are_right_to_single_precision() -> None:
    found = values(SINGLE, np.float32)
    y, x = VECTORS.astype(float).T
    right = {"sin": np.sin(ANGLES.astype(float)), "cos": np.cos(ANGLES.astype(float))}
    right |= {"atan2": np.arctan2(y, x), "hypot": np.hypot(y, x)}
    for name in ("sin", "cos", "atan2"):
        assert np.max(np.abs(found[name] - right[name])) <= (3e-7 if name == "atan2" else 1.2e-7), name
    assert np.max(np.abs(found["hypot"] - right["hypot"]) / np.maximum(right["hypot"], 1e-9)) <= 1.2e-7


@pytest.mark.parametrize("compiler", GCC_AND_CLANG)
@pytest.mark.parametrize("optimise", ["-O0", "-O3"])
def test_the_bits_in_c_are_those_of_the_functions(compiler: str, optimise: str, tmp_path: Path) -> None:
    require_compiler(compiler)
    (tmp_path / "vsg.h").write_text(TYPES)
    content = {"headline": "", "version": "", "printed_math": printed_math()}
    (tmp_path / "vsg_math.c").write_text(filled("vsg_math.c", content))
    place = tmp_path / "math.so"
    flags = ["-std=c99", optimise, "-ffp-contract=off", "-DVSG_PRINTED_MATH", "-shared", "-fPIC"]
    run_compiler([compiler, *flags, str(tmp_path / "vsg_math.c"), "-o", str(place), "-lm"])
    library, ours = ctypes.CDLL(str(place)), {}
    for name in SINGLE:
        call = getattr(library, f"vsg_printed_{name}")
        call.restype, call.argtypes = ctypes.c_float, [ctypes.c_float] * (2 if name in ("atan2", "hypot") else 1)
        ours[name] = call
    expected = values(SINGLE, np.float32)
    for name, told in values(ours, np.float32).items():
        assert np.array_equal(told.view(np.uint32), expected[name].view(np.uint32)), name
