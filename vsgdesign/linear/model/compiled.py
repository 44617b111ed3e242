"""The full-order model as a block of plain operations, for a host that has no CasADi.

CasADi has differentiated the period of the equations. What it has found is a list of operations on scalars, which are
written down one after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca

from vsgdesign.codegen.blocks import Writer
from vsgdesign.codegen.expressions import Expression, Number, Operation, Variable
from vsgdesign.codegen.flat import Block, flat_block
from vsgdesign.codegen.vector_math import PLAIN
from vsgdesign.linear.model.full_order import PARAMETERS, SETTINGS, FullOrderMap

_BINARY = {
    ca.OP_ADD: "+",
    ca.OP_SUB: "-",
    ca.OP_MUL: "*",
    ca.OP_DIV: "/",
    ca.OP_FMAX: "max",
    ca.OP_FMIN: "min",
    ca.OP_LE: "<=",
    ca.OP_LT: "<",
    ca.OP_EQ: "==",
    ca.OP_NE: "!=",
}
_UNARY = {ca.OP_NEG: "neg", ca.OP_SQRT: "sqrt", ca.OP_FABS: "abs", ca.OP_FLOOR: "floor"}
_FLAGS = ("<=", "<", "==", "!=")
_LOGIC = {ca.OP_NOT: "not", ca.OP_AND: "and", ca.OP_OR: "or"}
_CALLED = {
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_TAN: "tan",
    ca.OP_ATAN2: "atan2",
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_TANH: "tanh",
}
_ZERO, _ONE = Number(0.0), Number(1.0)


def block_of(function: ca.Function, inputs: Sequence[Sequence[str]], outputs: Sequence[Sequence[str]]) -> Block:
    """A function of scalars (SX) as a block. ``inputs`` and ``outputs`` have a name for every number of each argument
    and result, column by column.

    Raises ValueError for an operation that the language of blocks does not have.
    """
    writer = Writer()
    work: dict[int, Expression] = {}
    given = [[writer.input(name) for name in names] for names in inputs]
    for k in range(function.n_instructions()):
        does: int = function.instruction_id(k)
        into: list[int] = function.instruction_output(k)
        taken: list[int] = function.instruction_input(k)
        if does == ca.OP_INPUT:
            work[into[0]] = given[taken[0]][taken[1]]
        elif does == ca.OP_OUTPUT:
            writer.output(outputs[into[0]][into[1]], work[taken[0]])
        elif does == ca.OP_CONST:
            work[into[0]] = Number(float(function.instruction_constant(k)))
        else:
            work[into[0]] = _done(writer, does, [work[at] for at in taken])
    return writer.block()


def model_names(model: FullOrderMap) -> tuple[list[str], list[str]]:
    """A name for every number of z and of p. No state has the name of a parameter."""
    own = model.linear.size1_in(1) - len(PARAMETERS) - len(SETTINGS)
    parameters = [*PARAMETERS, *SETTINGS, *(f"limiter_constant_{k}" for k in range(own))]
    return [f"z.{name}" for name in model.states], parameters


def _done(writer: Writer, does: int, values: list[Expression]) -> Expression:
    """The value of one operation. A comparison gives 1 or 0, as a number."""
    one = values[0]
    if does in _CALLED:
        return _called(writer, PLAIN[_CALLED[does]], values)
    if does in _UNARY:
        return writer.does(_UNARY[does], one)
    if does in _BINARY:
        found = writer.does(_BINARY[does], *values)
        return writer.does("select", found, _ONE, _ZERO) if _BINARY[does] in _FLAGS else found
    if does in _LOGIC:
        flags = (writer.does("!=", value, _ZERO) for value in values[: 1 if does == ca.OP_NOT else 2])
        return writer.does("select", writer.does(_LOGIC[does], *flags), _ONE, _ZERO)
    if does == ca.OP_IF_ELSE_ZERO:
        return writer.does("select", writer.does("!=", one, _ZERO), values[1], _ZERO)
    if does == ca.OP_SIGN:
        negative = writer.does("select", writer.does("<", one, _ZERO), Number(-1.0), _ZERO)
        return writer.does("select", writer.does(">", one, _ZERO), _ONE, negative)
    if does == ca.OP_SQ:
        return writer.does("*", one, one)
    if does == ca.OP_TWICE:
        return writer.does("+", one, one)
    if does == ca.OP_INV:
        return writer.does("/", _ONE, one)
    raise ValueError(f"operation {does} of CasADi: blocks have no such operation. Add it to compiled.py.")


def _called(writer: Writer, function: Callable[..., Any], values: Sequence[Expression]) -> Expression:
    """A function of numbers, written out."""
    block = flat_block(function)
    here: dict[str, Expression] = dict(zip(block.inputs, values, strict=True))
    for name, let in block.lets:
        if not isinstance(let, Operation):
            raise TypeError(f"{name} of {function.__name__} is no operation.")
        arguments = (here[one.name] if isinstance(one, Variable) else one for one in let.arguments)
        here[name] = writer.does(let.name, *arguments)
    result = block.outputs[0][1]
    return here[result.name] if isinstance(result, Variable) else result
