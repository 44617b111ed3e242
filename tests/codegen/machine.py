"""A function of the restricted language as machine code that is called with numbers: a loop of one sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vsgdesign.codegen.llvm import LoopSpec, compiled_loop, flat_block


class Machine:
    """Called with every number of the arguments in order, those of records in their place. Returns every number of the
    results."""

    def __init__(self, function: Any, fixed: Mapping[str, Any] | None = None) -> None:
        block = flat_block(function, fixed=fixed)
        outputs = tuple(name for name, _ in block.outputs)
        spec = LoopSpec(
            (block,), ((block.inputs[0], outputs[0]),), constant=block.inputs[1:], logged=outputs, strict=True
        )
        self._loop, self._count = compiled_loop(spec), len(outputs)

    def __call__(self, numbers: Sequence[float]) -> list[float]:
        log = np.empty((1, 1, self._count, 1))
        rows = np.array(numbers, dtype=float)[None, :, None].copy()
        self._loop(0, 1, rows, np.zeros(0), log=log, every=1)
        return log.ravel().tolist()
