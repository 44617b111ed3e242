"""Compiled loops: many lanes through the same samples, from the plain functions of the equations.

:func:`flat_block` makes straight lines of functions, :class:`LoopSpec` says where each of their numbers comes from, and
:func:`compiled_loop` makes machine code of it. docs/theory/machine-code.md explains what is exact and what is not.
"""

from __future__ import annotations

import ctypes
import functools

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.flat import Block, flat_block
from vsgdesign.codegen.llvm_loop import NAME, loop_text
from vsgdesign.codegen.loop_call import Loop, Program, StandingLoop
from vsgdesign.codegen.loop_spec import LoopSpec
from vsgdesign.codegen.machine_code import compiled, target_named

__all__ = [
    "Block",
    "Loop",
    "LoopSpec",
    "Program",
    "StandingLoop",
    "aligned_zeros",
    "best_lanes",
    "compiled_loop",
    "empty_rows",
    "flat_block",
]

Floats = NDArray[np.float64]


def best_lanes(target: str = "native") -> int:
    """Numbers in a vector register: 8 with AVX-512, 4 with AVX2, else 2."""
    return target_named(target).lanes


def empty_rows(spec: LoopSpec, groups: int) -> Floats:
    """Zeros (G, R, L) for a loop."""
    return aligned_zeros((groups, len(spec.rows), spec.width))


def aligned_zeros(shape: tuple[int, ...]) -> Floats:
    """Zeros at an address that suits vectors: anywhere else, each of them lies on two lines of the cache."""
    count = int(np.prod(shape))
    room = np.empty(count + 8)  # many of them lie on large pages then, which take a tenth of the time to be there
    room[:] = 0.0
    start = (-room.ctypes.data % 64) // 8
    return room[start : start + count].reshape(shape)


@functools.lru_cache(maxsize=256)
def compiled_loop(spec: LoopSpec, target: str = "native", quickly: bool = False) -> Loop:
    """The loop as machine code, compiled once a process for each processor ``target``: native, avx512, avx2 or sse2.

    ``quickly``: for a loop that runs rarely. It is compiled in a fifth of the time and takes five times as long. A
    strict loop has the same bits either way.

    Raises ValueError where the specification does not fit together or this processor cannot run the target.
    """
    address = compiled(loop_text(spec), NAME, target, quickly)
    return Loop(spec, ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(address))
