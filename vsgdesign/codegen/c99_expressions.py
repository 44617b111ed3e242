"""Prints expressions and calls as C99, and the macros and small functions that they need."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

from vsgdesign.codegen.expressions import (
    ADVANCED,
    BITS,
    COUNT,
    NUMBERS,
    WHOLE,
    Argument,
    Expression,
    Field,
    Function,
    Invocation,
    Number,
    Numbers,
    Operation,
    RecordName,
    Variable,
    kind_of,
)
from vsgdesign.codegen.language import UntranslatableError
from vsgdesign.codegen.reader import Library

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
_CLIP = """/* x, drawn to between two limits; NaN where x is. */
static inline vsg_real_t vsg_clip(vsg_real_t x, vsg_real_t low, vsg_real_t high)
{
    const vsg_real_t y = ((x >= low) || (x != x)) ? x : low;
    return ((y <= high) || (y != y)) ? y : high;
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


SHORT = 1 << 16
"""A count below this is written short: unsigned int of a target has 16 bits at least."""

_MAX_COUNT = """/* The larger of two counts. */
static inline uint32_t vsg_max_count(uint32_t a, uint32_t b)
{
    return (a >= b) ? a : b;
}
"""
_MIN_COUNT = """/* The smaller of two counts. */
static inline uint32_t vsg_min_count(uint32_t a, uint32_t b)
{
    return (a <= b) ? a : b;
}
"""
_SEARCH = """/* How many numbers of an ascending row are not above x. */
static inline uint32_t vsg_not_above(vsg_numbers_t row, vsg_real_t x)
{
    uint32_t found = (uint32_t)0;
    while ((found < row.count) && (row.at[found] <= x)) {
        found = found + (uint32_t)1;
    }
    return found;
}
"""
_FINITE = """/* Whether a number is neither infinite nor NaN, by its bits: no option of a compiler changes that. */
static inline int vsg_is_number(vsg_real_t x)
{
#ifdef VSG_DOUBLE
    const uint64_t exponent = 0x7FF0000000000000ULL;
    uint64_t bits;
#else
    const uint32_t exponent = 0x7F800000UL;
    uint32_t bits;
#endif
    memcpy(&bits, &x, sizeof(bits));
    return (bits & exponent) != exponent;
}
"""
_HELPERS = {
    "finite": _FINITE,
    "max": _MAX,
    "min": _MIN,
    "clip": _CLIP,
    "max_count": _MAX_COUNT,
    "min_count": _MIN_COUNT,
    "search": _SEARCH,
    ADVANCED: _ADVANCED,
}
_OF_COUNTS = ("to real", "length", "read", "search", *BITS.values())

ROW_OF_NUMBERS = """/* A row of constants, and how many they are. */
typedef struct {
    const vsg_real_t *at;
    uint32_t count;
} vsg_numbers_t;
"""


class ExpressionPrinter:
    """Expressions of one function after the other; it remembers what they use."""

    def __init__(self, library: Library, printed: Collection[str] = ()) -> None:
        self.library, self.printed = library, printed
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
        if isinstance(e, Numbers):
            raise UntranslatableError("A row of numbers: C takes it from a record. Give the record as an argument.")
        return self.of_counts(e, above) if e.name in _OF_COUNTS else self.operation(e, above)

    def operation(self, e: Operation, above: int) -> str:
        """Operators, choices and mathematical functions."""
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
        elif (limits := _clipped(e)) is not None:
            self.used.add("clip")
            text = f"vsg_clip({', '.join(self.expression(one) for one in limits)})"
        elif (asked := _finite(e)) is not None:
            self.used.add("finite")
            precedence, text = _ATOM, f"vsg_is_number({self.expression(asked)})"
        elif precedence == _ATOM:
            if e.name not in ("max", "min"):
                self.used.add(e.name)
            name = f"VSG_{e.name.upper()}"
            if e.name in ("max", "min"):
                ending = "_count" if kind_of(e) == COUNT else ""
                name = f"vsg_{e.name}{ending}"
                self.used.add(f"{e.name}{ending}")
            text = f"{name}({', '.join(self.expression(argument) for argument in e.arguments)})"
        else:
            left, right = e.arguments
            text = f"{self.expression(left, precedence)} {e.name} {self.expression(right, precedence + 1)}"
        return f"({text})" if precedence < above else text

    def of_counts(self, e: Operation, above: int) -> str:
        """Counts bit by bit, a count as a number, and what is asked of a row of numbers."""
        first = e.arguments[0]
        if e.name == "to real":
            return f"(vsg_real_t){self.expression(first, _ATOM)}"
        if e.name == "length":
            return f"{self.expression(first, _ATOM)}.count"
        if e.name == "read":
            return f"{self.expression(first, _ATOM)}.at[{self.expression(e.arguments[1])}]"
        if e.name == "search":
            self.used.add("search")
            return f"vsg_not_above({self.expression(first)}, {self.expression(e.arguments[1])})"
        if e.name == "bitand" and getattr(e.arguments[1], "value", None) == WHOLE:  # a count of C has no more bits
            return self.expression(first, above)
        symbol = "&" if e.name == "bitand" else "|"
        text = f"{self.expression(first, _ATOM)} {symbol} {self.expression(e.arguments[1], _ATOM)}"
        return f"({text})" if above else text

    def enclosed(self, e: Expression) -> str:
        """In parentheses, as a condition is read without knowing what binds how."""
        return f"({self.expression(e)})" if isinstance(e, Operation) and e.name != "not" else self.expression(e)

    def number(self, number: Number) -> str:
        if isinstance(number.value, bool):
            return str(int(number.value))
        if not math.isfinite(number.value):
            raise UntranslatableError(f"constant {number.name or number.value}: is not finite. Give a large number.")
        if number.name in self.library.macros:
            return self.library.macros[number.name]
        if number.name:
            name = f"{self.library.prefix}{number.name}".upper()
            if self.constants.setdefault(name, number.value) != number.value:
                raise UntranslatableError(
                    f"constant {number.name}: has two values, {self.constants[name]!r} and {number.value!r}, in the "
                    "functions that are translated together. Give one of them another name."
                )
            return f"VSG_{name}"
        return _literal(number.value)

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
        mathematical = sorted(self.used - {*_HELPERS, NUMBERS})
        text = ""
        if mathematical:
            pairs = [(f"VSG_{name.upper()}", _LIBRARY.get(name, name)) for name in mathematical]
            double = "\n".join(f"#define {macro} {name}" for macro, name in pairs)
            single = "\n".join(f"#define {macro} {name}f" for macro, name in pairs)
            text += f"#ifdef VSG_DOUBLE\n{double}\n#else\n{single}\n#endif\n"
            own = [name for name in mathematical if name in self.printed]
            if own:
                lines = (f"#undef VSG_{name.upper()}\n#define VSG_{name.upper()} vsg_printed_{name}\n" for name in own)
                text += f"#ifdef VSG_PRINTED_MATH\n{''.join(lines)}#endif\n"
            text += "\n"
        for name, value in self.constants.items():
            text += f"#define VSG_{name} {_literal(value)}\n"
        text += "\n" if self.constants else ""
        return text + "\n".join(helper for name, helper in _HELPERS.items() if name in self.used)


def _clipped(e: Operation) -> tuple[Expression, ...] | None:
    """A number and the limits to between which it is drawn; None of anything else."""
    inner = e.arguments[0]
    if e.name == "min" and isinstance(inner, Operation) and inner.name == "max" and kind_of(e) != COUNT:
        return *inner.arguments, e.arguments[1]
    return None


def _finite(e: Operation) -> Expression | None:
    """The number of which ``x - x == 0.0`` asks whether it is finite; None of anything else."""
    left, right = e.arguments if e.name == "==" else (None, None)
    if isinstance(left, Operation) and left.name == "-" and left.arguments[0] == left.arguments[1]:
        return left.arguments[0] if isinstance(right, Number) and right.value == 0.0 else None
    return None


def _literal(value: float) -> str:
    if type(value) is not int:
        return f"VSG_C({value!r})"
    return f"{value}U" if value < SHORT else f"((uint32_t){value}UL)"


def _chain(e: Operation) -> list[Expression]:
    """What one "and" or one "or" joins, in order."""
    first, last = e.arguments
    return [*(_chain(first) if isinstance(first, Operation) and first.name == e.name else [first]), last]
