"""What one step of the compiled loop consists of, and the chain of operations that no processor can do side by side."""

from __future__ import annotations

from collections import Counter

from bench.timing import Figure, Row
from vsgdesign.codegen.expressions import Operation, Variable
from vsgdesign.codegen.flat import Block
from vsgdesign.equations.controller_data import Nothing
from vsgdesign.equations.limiters import CIRCULAR
from vsgdesign.simulation.loop import loop_of
from vsgdesign.simulation.run_kind import Bridge, Kind

KINDS = {"+": "sums", "-": "sums", "*": "products", "/": "divisions", "sqrt": "roots", "max": "maxima"}
OTHERS = "comparisons and choices"
CYCLES = {"sums": 3, "products": 3, "divisions": 14, "roots": 13, "maxima": 4, OTHERS: 1}
"""How long the next operation waits for each; they decide which chain is the longest (bench/README.md)."""


def kind_of(operation: Operation) -> str:
    """What an operation is counted as."""
    return KINDS.get(operation.name, OTHERS)


def chain_of(block: Block, begin: str, end: str) -> Counter[str]:
    """The operations of the longest chain from an input to an output of a block, by kind; empty if there is none."""
    longest: dict[str, tuple[int, Counter[str]]] = {begin: (0, Counter())}
    for name, value in block.lets:
        if not isinstance(value, Operation):
            continue
        read = [longest[one.name] for one in value.arguments if isinstance(one, Variable) and one.name in longest]
        if read:
            cycles, before = max(read, key=lambda one: one[0])
            longest[name] = cycles + CYCLES[kind_of(value)], before + Counter([kind_of(value)])
    last = dict(block.outputs)[end]
    return longest[last.name][1] if isinstance(last, Variable) and last.name in longest else Counter()


def chain() -> list[Row]:
    """All operations of a step with the averaged bridge, and those of the longest chain from a state of the circuit
    back to itself: a step cannot take less time than these one after the other."""
    loop = loop_of(Kind(law=CIRCULAR.law, memory=Nothing, constants=Nothing, bridge=Bridge())).spec
    (block,) = loop.bodies
    whole = Counter(kind_of(value) for _, value in block.lets if isinstance(value, Operation))
    circuit = [(begin, end) for begin, end in loop.state if begin.startswith("x.")]
    longest = max((chain_of(block, *pair) for pair in circuit), key=lambda found: cycles_of(found))
    return [
        Row("chain", f"averaged: {what}, {kind}", Figure(count, count, count, 1), "operations")
        for what, counts in (("one step", whole), ("longest chain", longest))
        for kind, count in sorted(counts.items())
    ]


def cycles_of(counts: Counter[str]) -> int:
    """How long these operations take one after the other."""
    return sum(CYCLES[kind] * count for kind, count in counts.items())


BENCHMARKS = {"chain": chain}
