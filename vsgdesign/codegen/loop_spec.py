"""What a compiled loop is made of, and where each of its numbers comes from."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property

from vsgdesign.codegen.expressions import Variable
from vsgdesign.codegen.flat import PACKED, Block


@dataclass(frozen=True)
class Product:
    """A matrix times numbers of the state, as a loop of fixed length: its text does not grow with the matrix.

    It is computed at the beginning of every sample. Each sum is taken in the order of ``factors``.
    """

    results: tuple[str, ...]
    """Inputs of the bodies, one for each row of the matrix."""
    matrix: tuple[str, ...]
    """Rows of a group that are beside each other: the matrix column by column."""
    factors: tuple[str, ...]
    """Rows of the state that are beside each other, one for each column."""
    turns: int = 1
    """Matrices beside each other, one for each sample of a period; 1: the same in every sample."""


@dataclass(frozen=True)
class LoopSpec:
    """Samples one after the other, each for many lanes at once.

    ``bodies`` are kinds of sample with the same inputs and outputs. Every input that a body reads has exactly one
    place. Names of inputs and outputs are those of :class:`Block`.
    """

    bodies: tuple[Block, ...]
    state: tuple[tuple[str, str], ...]
    """(input, output): the output of a sample is the input of the next."""
    constant: tuple[str, ...] = ()
    """Inputs with one value a lane."""
    uniform: tuple[str, ...] = ()
    """Inputs with one value for all; never NaN."""
    cyclic: tuple[str, ...] = ()
    """Inputs with one value for all that depends on the sample's number modulo a period."""
    fed: tuple[str, ...] = ()
    """Inputs that are given for every sample and lane."""
    rings: tuple[tuple[str, str], ...] = ()
    """(input, output): the input is what the output was ``ring_length`` samples ago."""
    products: tuple[Product, ...] = ()
    """Products of matrices and numbers of the state."""
    logged: tuple[str, ...] = ()
    """Outputs, or inputs of the state, that are written at every ``every``-th sample of the run."""
    slot: str = ""
    """The output that says in which slot of its own each lane logs this sample; the log is then (G, L, slots, n), and
    what lies before the first slot or behind the last one lands there. Empty: all lanes log in that of the sample."""
    index: str = ""
    """The input that is the number of samples since ``origin``."""
    stop: str = ""
    """The output that ends the loop after the sample in which it is not zero in any lane."""
    lanes: int = 1
    """Numbers in a vector register: 1, 2, 4 or 8."""
    vectors: int = 1
    """Vectors side by side, so that one waits while another computes."""
    strict: bool = False
    """Every operation rounds by itself, as plain Python does. Otherwise a product and a sum may round as one, and a
    division may become a product with the reciprocal."""

    @property
    def width(self) -> int:
        """Lanes of a group, L."""
        return self.lanes * self.vectors

    @cached_property
    def rows(self) -> tuple[str, ...]:
        """Inputs that are rows of a group, in order: the state, then the constants."""
        return (*(name for name, _ in self.state), *self.constant)

    @property
    def multiplied(self) -> tuple[str, ...]:
        """Inputs that are results of products, in order."""
        return tuple(name for product in self.products for name in product.results)

    def check(self) -> None:
        """Raises ValueError with everything that does not fit."""
        faults = [*self._shape_faults(), *self._place_faults(), *self._product_faults(), *self._output_faults()]
        if faults:
            raise ValueError("A loop cannot be built: " + "; ".join(faults) + ".")

    def _shape_faults(self) -> list[str]:
        faults = []
        if not self.bodies:
            faults.append("bodies is empty: give at least one block")
        if not self.state:
            faults.append("state is empty: a loop moves at least one number")
        if self.lanes not in (1, 2, 4, 8):
            faults.append(f"lanes = {self.lanes}: give 1, 2, 4 or 8")
        if self.width > 1 and any(getattr(value, "name", "") == PACKED for one in self.bodies for _, value in one.lets):
            faults.append(f"a body does the same for several at once, in {self.width} lanes: give one lane")
        if not 1 <= self.vectors <= 8:
            faults.append(f"vectors = {self.vectors}: give 1 to 8")
        for at, body in enumerate(self.bodies[1:], 1):
            if {name for name, _ in body.outputs} != {name for name, _ in self.bodies[0].outputs}:
                faults.append(f"body {at} has other outputs than body 0: give the same ones")
        return faults

    def _place_faults(self) -> list[str]:
        ring_inputs = (name for name, _ in self.rings)
        places = [
            *self.rows,
            *self.uniform,
            *self.cyclic,
            *self.fed,
            *ring_inputs,
            *self.multiplied,
            *([self.index] if self.index else []),
        ]
        known = {name for body in self.bodies for name in body.inputs}
        known |= {name for product in self.products for name in product.matrix}
        read = {name for body in self.bodies for name in inputs_read(body)}
        faults = [
            f"input {name} has {count} places: give it one" for name, count in Counter(places).items() if count > 1
        ]
        faults += [f"{name} is no input of a body: leave it out" for name in dict.fromkeys(places) if name not in known]
        faults += [
            f"input {name} has no place: name it in state, constant, uniform or another"
            for name in sorted(read - set(places))
        ]
        return faults

    def _product_faults(self) -> list[str]:
        faults = []
        for product in self.products:
            rows, columns = len(product.results), len(product.factors)
            if len(product.matrix) != rows * columns * product.turns or not rows * columns:
                faults.append(f"a product of {rows} x {columns} has {len(product.matrix)} numbers: give one for each")
            if product.turns > 1 and len(self.bodies) == 1:
                faults.append("a product differs from sample to sample, which a loop with one body does not count")
            for what, names in (("matrix", product.matrix), ("factors", product.factors)):
                first = self.rows.index(names[0]) if names and names[0] in self.rows else 0
                if self.rows[first : first + len(names)] != names:
                    faults.append(f"the {what} of a product are no rows beside each other: put them so")
        return faults

    def _output_faults(self) -> list[str]:
        if not self.bodies:
            return []
        outputs = {name for name, _ in self.bodies[0].outputs}
        wanted = [output for _, output in (*self.state, *self.rings)]
        wanted += [name for name in (self.stop, self.slot) if name]
        faults = [
            f"{name} is no output of a body: name one of its outputs"
            for name in dict.fromkeys(wanted)
            if name not in outputs
        ]
        may = outputs | {name for name, _ in self.state}
        faults += [
            f"logged {name} is neither an output nor an input of the state" for name in self.logged if name not in may
        ]
        return faults


def inputs_read(block: Block) -> set[str]:
    """Inputs that an operation or an output of the block reads."""
    inputs = set(block.inputs)
    read = {value.name for _, value in block.outputs if isinstance(value, Variable)}
    for _, value in block.lets:
        read |= {one.name for one in getattr(value, "arguments", ()) if isinstance(one, Variable)}
    return read & inputs
