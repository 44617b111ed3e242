"""Prints expressions and calls as C99, and the macros and small functions that they need."""

from __future__ import annotations

import math
from collections.abc import Sequence

from vsgdesign.codegen.expressions import (
    ADVANCED,
    Argument,
    Expression,
    Field,
    Function,
    Invocation,
    Number,
    Operation,
    RecordName,
    Variable,
)
from vsgdesign.codegen.reader import Library
from vsgdesign.codegen.source import UntranslatableError

_PRECEDENCE = {"select": 1, "or": 2, "and": 3, "==": 4, "!=": 4, "<": 5, ">": 5, "<=": 5, ">=": 5}
_PRECEDENCE |= {"+": 6, "-": 6, "*": 7, "/": 7, "neg": 8, "not": 8}
_ATOM = 9
_SYMBOLS = {"and": "&&", "or": "||"}
_LIBRARY = {"abs": "fabs"}
"""C's name of a function where it is another one; single precision has an f at its end."""

_MAX = """/* The larger of two; NaN where either is. */
static inline vsg_real_t vsg_max(vsg_real_t a, vsg_real_t b)
{
    return ((a >= b) || (a != a)) ? a : b;
}
"""
_MIN = """/* The smaller of two; NaN where either is. */
static inline vsg_real_t vsg_min(vsg_real_t a, vsg_real_t b)
{
    return ((a <= b) || (a != a)) ? a : b;
}
"""
_ADVANCED = """\
/* The integrator x after its change dx of one sample. In single precision T_s times a rate may be less than the
 * last digit of x: what a sum leaves out is kept in lost for the next one (Kahan). In double it is x + dx. */
static inline vsg_real_t vsg_advanced(vsg_real_t x, vsg_real_t dx, vsg_real_t *lost)
{
#ifdef VSG_DOUBLE
    *lost = VSG_C(0.0);
    return x + dx;
#else
    const vsg_real_t change = dx - *lost;
    const vsg_real_t sum = x + change;
    *lost = (sum - x) - change;
    return sum;
#endif
}
"""


class ExpressionPrinter:
    """Expressions of one function after the other; it remembers what they use."""

    def __init__(self, library: Library) -> None:
        self.library = library
        self.used: set[str] = set()
        """Mathematical functions."""
        self.constants: dict[str, float] = {}
        self.pointers: set[str] = set()
        """Records of the function at hand that came in as pointers."""

    def expression(self, e: Expression, above: int = 0) -> str:
        if isinstance(e, Number):
            return self.number(e)
        if isinstance(e, Variable):
            return e.name
        if isinstance(e, Field):
            pointer = e.record in self.pointers
            if not e.path:  # all of a record
                return f"*{e.record}" if pointer else e.record
            return f"{e.record}{'->' if pointer else '.'}{e.path}"
        if isinstance(e, Invocation):
            return self.invoked(e.function, e.arguments)
        precedence, text = _PRECEDENCE.get(e.name, _ATOM), ""
        if e.name == ADVANCED:
            self.used.add(ADVANCED)
            x, dx = e.arguments
            kept = f"&{x.record}_lost->{x.path}" if isinstance(x, Field) else f"{self.expression(x)}_lost"
            text = f"vsg_advanced({self.expression(x)}, {self.expression(dx)}, {kept})"
        elif e.name in ("neg", "not"):
            text = f"{'-' if e.name == 'neg' else '!'}{self.expression(e.arguments[0], _ATOM)}"
        elif e.name == "select":
            condition, one, other = e.arguments
            text = f"{self.enclosed(condition)} ? {self.expression(one, 2)} : {self.expression(other, 2)}"
        elif e.name in _SYMBOLS:
            text = f" {_SYMBOLS[e.name]} ".join(self.enclosed(argument) for argument in _chain(e))
        elif precedence == _ATOM:
            self.used.add(e.name)
            name = f"vsg_{e.name}" if e.name in ("max", "min") else f"VSG_{e.name.upper()}"
            text = f"{name}({', '.join(self.expression(argument) for argument in e.arguments)})"
        else:
            left, right = e.arguments
            text = f"{self.expression(left, precedence)} {e.name} {self.expression(right, precedence + 1)}"
        return f"({text})" if precedence < above else text

    def enclosed(self, e: Expression) -> str:
        """In parentheses, as a condition is read without knowing what binds how."""
        return f"({self.expression(e)})" if isinstance(e, Operation) and e.name != "not" else self.expression(e)

    def number(self, number: Number) -> str:
        if isinstance(number.value, bool):
            return str(int(number.value))
        if not math.isfinite(number.value):
            raise UntranslatableError(f"constant {number.name or number.value}: is not finite. Give a large number.")
        if number.name:
            name = f"{self.library.prefix}{number.name}".upper()
            if self.constants.setdefault(name, number.value) != number.value:
                raise UntranslatableError(
                    f"constant {number.name}: has two values, {self.constants[name]!r} and {number.value!r}, in the "
                    "functions that are translated together. Give one of them another name."
                )
            return f"VSG_{name}"
        return f"VSG_C({number.value!r})"

    def invoked(self, function: Function, arguments: Sequence[Argument], targets: Sequence[str] = ()) -> str:
        given = [self.argument(argument) for argument in arguments]
        for parameter, argument in zip(function.parameters, arguments, strict=True):
            if parameter.name not in function.lost:
                continue
            if isinstance(argument, Field):
                given.append(f"&{argument.record}_lost->{argument.path}")
            elif isinstance(argument, RecordName) and argument.path:
                given.append(f"&{argument.name}_lost->{argument.path}")
            elif isinstance(argument, Variable | RecordName):
                given.append(f"{argument.name}_lost")
        return f"vsg_{function.name}({', '.join([*given, *targets])})"

    def whole(self, record: RecordName) -> str:
        """A record as a value."""
        return self.expression(Field(record.name, record.path))

    def argument(self, argument: Argument) -> str:
        if isinstance(argument, RecordName):
            if argument.path:
                return f"&{argument.name}{'->' if argument.name in self.pointers else '.'}{argument.path}"
            return argument.name if argument.name in self.pointers else f"&{argument.name}"
        return self.expression(argument)

    def macros(self) -> str:
        mathematical = sorted(self.used - {"max", "min", ADVANCED})
        text = ""
        if mathematical:
            pairs = [(f"VSG_{name.upper()}", _LIBRARY.get(name, name)) for name in mathematical]
            double = "\n".join(f"#define {macro} {name}" for macro, name in pairs)
            single = "\n".join(f"#define {macro} {name}f" for macro, name in pairs)
            text += f"#ifdef VSG_DOUBLE\n{double}\n#else\n{single}\n#endif\n\n"
        for name, value in self.constants.items():
            text += f"#define VSG_{name} VSG_C({value!r})\n"
        text += "\n" if self.constants else ""
        helpers = (("max", _MAX), ("min", _MIN), (ADVANCED, _ADVANCED))
        return text + "\n".join(helper for name, helper in helpers if name in self.used)


def _chain(e: Operation) -> list[Expression]:
    """What one "and" or one "or" joins, in order."""
    first, last = e.arguments
    return [*(_chain(first) if isinstance(first, Operation) and first.name == e.name else [first]), last]
