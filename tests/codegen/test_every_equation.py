"""Every function of ``equations`` and ``frames`` as a strict loop: the bits of Python that runs the same text."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import pytest

from tests.codegen.test_same_numbers import TRANSLATED, Limits, filled
from tests.codegen.twins import twin
from tests.equations.test_three_ways import FLAGS, FUNCTIONS, arguments, draw, flat
from vsgdesign.codegen.llvm import LoopSpec, compiled_loop, empty_rows, flat_block
from vsgdesign.equations.limiters import CIRCULAR

ROWS = 16


@pytest.mark.parametrize("name", TRANSLATED)
def test_a_strict_loop_has_the_bits_of_python(name: str) -> None:
    function, columns = FUNCTIONS[name], []
    rng = np.random.default_rng(sum(name.encode()))

    def column(field: str) -> float:
        limits = Limits()
        draw(field, limits)  # type: ignore[arg-type]
        columns.append(rng.integers(0, 2, ROWS) if field in FLAGS else rng.uniform(*limits.found, ROWS))
        return 0.0

    shape = arguments(function, column)
    given = np.array(columns, dtype=float)
    known = {"limiter": CIRCULAR.law} if "limiter" in inspect.signature(function).parameters else {}
    block = flat_block(function, fixed=known)
    outputs = [name for name, _ in block.outputs]
    spec = LoopSpec(
        (block,), ((block.inputs[0], outputs[0]),), block.inputs[1:], logged=tuple(outputs), lanes=8, strict=True
    )
    rows = empty_rows(spec, ROWS // 8)
    rows[:] = np.swapaxes(given.reshape(len(given), -1, 8), 0, 1)
    log = np.zeros((ROWS // 8, 1, len(outputs), 8))
    compiled_loop(spec, quickly=True)(0, 1, rows, np.zeros(0), log=log, every=1)
    found = np.swapaxes(log[:, 0], 1, 2).reshape(ROWS, -1)
    own: Any = twin(function)
    expected = [flat(own(*twin(filled(shape, iter(row))))) for row in given.T.tolist()]
    np.testing.assert_array_equal(found, np.array(expected, dtype=float).reshape(ROWS, -1))
