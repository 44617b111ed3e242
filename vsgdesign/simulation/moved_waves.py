"""What a source that wanders adds, computed by machine code for eight samples side by side.

A sample of the path follows from the one before it. What it adds does not: the phasors of all waves, which are whole
powers of the fundamental's, and their sum over all that they add.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.blocks import Part, Writer, joined
from vsgdesign.codegen.expressions import Expression, Number, Variable
from vsgdesign.codegen.flat import Block, flat_block
from vsgdesign.codegen.llvm import LoopSpec, aligned_zeros, compiled_loop, empty_rows
from vsgdesign.equations.grid import moved_phasor

Array = NDArray[np.float64]

LANES = 8
"""Samples side by side, on every processor: the numbers of a run do not depend on it."""

_OF_ALL = ("omega", "cosine", "sine", "T_s")


class MovedWaves:
    """The loop for the changes of the fundamental and for waves of other orders. It serves one thread."""

    def __init__(self, orders: tuple[int, ...], columns: int) -> None:
        """``orders`` of the waves besides the fundamental, not 0; ``columns``: numbers that a sample adds."""
        spec = waves_spec(orders, columns)
        self._loop, self._columns = compiled_loop(spec), columns
        self._rows = empty_rows(spec, 1)
        self._rows[0, 0] = np.arange(LANES)
        self._fed, self._log = self._room(0)

    def _room(self, steps: int) -> tuple[Array, Array]:
        return aligned_zeros((1, steps, 2, LANES)), aligned_zeros((1, steps, self._columns, LANES))

    def over(self, moved: tuple[Array, Array], turn: tuple[float, float, float], T_s: float, parts: Array) -> Array:
        """What is added in samples whose source is ``moved`` by a gain and an angle (rad), (count,): (count, columns).

        ``turn``: angular frequency (rad/s) of the fundamental, cosine and sine of its phase at the first sample;
        ``parts`` (2m, columns): what real and imaginary part of each wave add."""
        count = len(moved[0])
        steps, (whole, left) = -(-count // LANES), divmod(count, LANES)
        if self._fed.shape[1] < steps:
            self._fed, self._log = self._room(steps)
        for k, values in enumerate(moved):
            self._fed[0, :whole, k] = values[: count - left].reshape(whole, LANES)
            self._fed[0, whole:steps, k, :left] = values[count - left :]
        uniform = np.concatenate([[*turn, T_s], parts.reshape(-1)])
        fed, log = self._fed[:, :steps], self._log[:, :steps]
        self._loop(0, steps, self._rows, uniform, fed=fed, log=log, every=1)
        return log[0].transpose(1, 0, 2).copy().reshape(self._columns, -1)[:, :count].T


@functools.cache
def waves_spec(orders: tuple[int, ...], columns: int) -> LoopSpec:
    """A loop of eight samples each."""
    line = Writer()
    first = line.does("*", line.input("index"), Number(float(LANES)))
    sample = line.does("+", first, line.input("place"))
    since = line.does("*", sample, line.input("T_s"))
    line.output("turned", line.does("*", since, line.input("omega")))
    line.output("next_place", line.input("place"))
    block = joined(Part(line.block()), Part(flat_block(moved_phasor)), Part(_added(orders, columns)))
    return LoopSpec(
        bodies=(block,),
        state=(("place", "next_place"),),
        uniform=(*_OF_ALL, *_parts(len(orders) + 1, columns)),
        fed=("gain", "angle"),
        logged=tuple(f"added_{column}" for column in range(columns)),
        index="index",
        lanes=LANES,
        strict=True,
    )


def _parts(waves: int, columns: int) -> list[str]:
    return [f"part_{row}_{column}" for row in range(2 * waves) for column in range(columns)]


def _added(orders: tuple[int, ...], columns: int) -> Block:
    """The whole powers of the moved phasor, and what they add."""
    line = Writer()
    found: dict[int, tuple[Expression, Expression]] = {1: (line.input("moved_re"), line.input("moved_im"))}

    def power(n: int) -> tuple[Expression, Expression]:
        if n not in found:
            if n < 0:
                re, im = power(-n)
                found[n] = re, line.does("neg", im)
            else:
                (a, b), (c, d) = power(n // 2), power(n - n // 2)
                re = line.does("-", line.does("*", a, c), line.does("*", b, d))
                found[n] = re, line.does("+", line.does("*", a, d), line.does("*", b, c))
        return found[n]

    waves: list[Expression] = [line.input("change_re"), line.input("change_im")]
    for n in orders:
        waves += power(n)
    for column in range(columns):
        terms = [line.does("*", wave, _part(line, row, column)) for row, wave in enumerate(waves)]
        line.output(f"added_{column}", line.sum_of(*terms))
    return line.block()


def _part(line: Writer, row: int, column: int) -> Variable:
    return line.input(f"part_{row}_{column}")
