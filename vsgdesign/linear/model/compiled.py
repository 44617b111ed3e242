"""What CasADi has differentiated, as machine code: a block of plain operations, or a list of them.

CasADi's functions of scalars are lists of operations. :func:`block_of` writes them down one after the other, for a host
that has no CasADi, such as the full-order model on a page. :func:`list_of` takes lists that are too long to be
compiled, and does them for several points at once.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.blocks import Writer
from vsgdesign.codegen.expressions import Expression, Number, Operation, Variable
from vsgdesign.codegen.flat import Block, flat_block
from vsgdesign.codegen.operation_list import LANES, OperationList
from vsgdesign.codegen.vector_math import PLAIN
from vsgdesign.linear.model.full_order import PARAMETERS, SETTINGS, FullOrderMap

_BINARY = {
    **{"add": "+", "sub": "-", "mul": "*", "div": "/", "fmax": "max", "fmin": "min"},
    **{"le": "<=", "lt": "<", "eq": "==", "ne": "!="},
}
_UNARY = {"neg": "neg", "sqrt": "sqrt", "fabs": "abs", "floor": "floor"}
_FLAGS = ("<=", "<", "==", "!=")
_LOGIC = ("not", "and", "or")
_CALLED = ("sin", "cos", "tan", "atan2", "exp", "log", "tanh")
_ZERO, _ONE = Number(0.0), Number(1.0)

_Value = TypeVar("_Value")


def block_of(function: ca.Function, inputs: Sequence[Sequence[str]], outputs: Sequence[Sequence[str]]) -> Block:
    """A function of scalars (SX) as a block. ``inputs`` and ``outputs`` have a name for every number of each argument
    and result, column by column.

    Raises ValueError for an operation that the language of blocks does not have.
    """
    writer = Writer()
    given: list[list[Expression]] = [[writer.input(name) for name in names] for names in inputs]
    found = _followed(function, given, Number, lambda does, values: _done(writer, does, values))
    for result, place, value in found:
        writer.output(outputs[result][place], value)
    return writer.block()


def list_of(function: ca.Function) -> OperationList:
    """A function of scalars (SX) as a list of operations for several points at once. Its inputs and outputs are the
    nonzeros of the function's, one after the other, and every bit is that of CasADi.

    Raises ValueError for an operation that a list does not have.
    """
    count, constants = sum(function.nnz_in(k) for k in range(function.n_in())), {1.0: -1}
    numbers, kinds, taken = itertools.count(), list[str](), list[tuple[int, int]]()
    given = [list(itertools.islice(numbers, function.nnz_in(k))) for k in range(function.n_in())]

    def does(name: str, values: Sequence[int]) -> int:
        if name == "assign":
            return values[0]
        kinds.append(_OF_LIST.get(name, name))
        taken.append((-1, values[0]) if name == "inv" else (values[0], values[-1]))
        return count + len(kinds) - 1

    # Constants are counted down from −1 until it is known how many there are.
    found = list(_followed(function, given, lambda value: constants.setdefault(value, -1 - len(constants)), does))
    ends = [0, *itertools.accumulate(function.nnz_out(k) for k in range(function.n_out()))]
    outputs = np.full(ends[-1], -1)
    for result, place, value in found:
        outputs[ends[result] + place] = value

    def counted(values: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.where(values < 0, count - 1 - values, values + len(constants) * (values >= count))

    operands = counted(np.array(taken, dtype=np.int64).reshape(-1, 2))
    return OperationList(count, list(constants), kinds, operands, counted(outputs).tolist())


_OF_LIST = {"sq": "mul", "twice": "add", "inv": "div", "constpow": "pow"}
"""What CasADi has a name for and a list does by another operation, with the same bits."""


def _followed(
    function: ca.Function,
    given: Sequence[Sequence[_Value]],
    constant: Callable[[float], _Value],
    does: Callable[[str, Sequence[_Value]], _Value],
) -> Iterator[tuple[int, int, _Value]]:
    """Does the operations of a function one after the other, with the values that are ``given`` for its arguments;
    yields number of the result, place in it and value. Operations have CasADi's names in small letters."""
    held: dict[int, _Value] = {}
    names = _names()
    for k in range(function.n_instructions()):
        name = names[function.instruction_id(k)]
        into, taken = function.instruction_output(k), function.instruction_input(k)
        if name == "input":
            held[into[0]] = given[taken[0]][taken[1]]
        elif name == "output":
            yield into[0], into[1], held[taken[0]]
        elif name == "const":
            held[into[0]] = constant(float(function.instruction_constant(k)))
        else:
            held[into[0]] = does(name, [held[at] for at in taken])


@functools.cache
def _names() -> dict[int, str]:
    return {getattr(ca, name): name[3:].lower() for name in dir(ca) if name.startswith("OP_")}


def model_names(model: FullOrderMap) -> tuple[list[str], list[str]]:
    """A name for every number of z and of p. No state has the name of a parameter."""
    own = model.linear.size1_in(1) - len(PARAMETERS) - len(SETTINGS)
    parameters = [*PARAMETERS, *SETTINGS, *(f"limiter_constant_{k}" for k in range(own))]
    return [f"z.{name}" for name in model.states], parameters


def _done(writer: Writer, does: str, values: Sequence[Expression]) -> Expression:
    """The value of one operation. A comparison gives 1 or 0, as a number."""
    one = values[0]
    if does in _CALLED:
        return _called(writer, PLAIN[does], values)
    if does in _UNARY:
        return writer.does(_UNARY[does], one)
    if does in _BINARY:
        found = writer.does(_BINARY[does], *values)
        return writer.does("select", found, _ONE, _ZERO) if _BINARY[does] in _FLAGS else found
    if does in _LOGIC:
        flags = (writer.does("!=", value, _ZERO) for value in values[: 1 if does == "not" else 2])
        return writer.does("select", writer.does(does, *flags), _ONE, _ZERO)
    if does == "if_else_zero":
        return writer.does("select", writer.does("!=", one, _ZERO), values[1], _ZERO)
    if does == "sign":
        negative = writer.does("select", writer.does("<", one, _ZERO), Number(-1.0), _ZERO)
        return writer.does("select", writer.does(">", one, _ZERO), _ONE, negative)
    if does == "sq":
        return writer.does("*", one, one)
    if does == "twice":
        return writer.does("+", one, one)
    if does == "inv":
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


class InLanes(ca.Callback):
    """An expanded function f(x, column, last) as CasADi's function F(x, columns): its results for all columns, one
    below the other. A column is a lane, so that all of them take as long as one (docs/theory/machine-code.md).

    CasADi has no derivative of it: make another one of the derivative of f. It has to be kept for as long as a function
    of CasADi uses it.
    """

    def __init__(self, of_one: ca.Function, columns: int, last: Sequence[float] = ()) -> None:
        """``columns``: at most as many as a list has lanes. ``last``: the numbers of the last input. Raises ValueError
        as :func:`list_of`."""
        super().__init__()
        given = ca.Sparsity.dense(of_one.size1_in(0)), ca.Sparsity.dense(of_one.size1_in(1), columns)
        self._given, self._columns, self._list = given, columns, list_of(of_one)
        self._last = np.reshape(last, (-1, 1))
        # CasADi has the nonzeros of a matrix column by column, and a list has those of each lane.
        one = of_one.sparsity_out(0)
        placed = ca.vertcat(*(ca.DM(one, np.arange(one.nnz()) * columns + lane) for lane in range(columns)))
        self._found, self._order = placed.sparsity(), np.array(placed.nonzeros(), dtype=np.int64)
        self.construct(of_one.name(), {})

    def get_n_in(self) -> int:
        """x and the columns."""
        return 2

    def get_n_out(self) -> int:
        """The results."""
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Both are dense."""
        return self._given[i]

    def get_sparsity_out(self, i: int) -> ca.Sparsity:  # noqa: ARG002
        """That of one result as often as there are columns."""
        return self._found

    def has_eval_buffer(self) -> bool:
        """CasADi gives memory, and no matrices of its own."""
        return True

    def eval_buffer(self, arg: Sequence[Any], res: Sequence[Any]) -> int:
        """Does the operations; 0, as CasADi wants it where nothing is wrong."""
        shared, columns = np.frombuffer(arg[0])[:, None], np.frombuffer(arg[1]).reshape(self._columns, -1).T
        begin, end = len(shared), len(shared) + len(columns)
        inputs = np.empty((self._list.inputs, LANES))
        inputs[:begin], inputs[end:] = shared, self._last
        inputs[begin:end, : self._columns] = columns
        inputs[begin:end, self._columns :] = columns[:, :1]  # a lane without a column does what is done anyway
        np.frombuffer(res[0])[:] = self._list.run(inputs)[:, : self._columns].ravel()[self._order]
        return 0
