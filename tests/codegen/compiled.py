"""Generated functions in a library of this process: rows of inputs in, rows of outputs out."""

from __future__ import annotations

import ctypes
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen import CText
from vsgdesign.export.compiled import run_compiler

FLAGS = (
    "-std=c99", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wshadow",
    "-Wpedantic", "-Werror",
)  # fmt: skip


@dataclass(frozen=True)
class Argument:
    """One argument of a C function, from its declaration."""

    kind: str
    name: str
    count: int
    """Scalars in it."""
    role: str
    """in, flag, lost or out."""


class Compiled:
    """A library with one loop over rows for each function, optimised or compiled in half the time."""

    def __init__(self, text: CText, build: Path, compiler: str, double: bool, optimised: bool = True) -> None:
        self.real = np.float64 if double else np.float32
        bare = re.sub(r"/\*.*?\*/", "", "".join(text.structs.values()), flags=re.DOTALL)
        sizes: dict[str, int] = {}
        for body, name in re.findall(r"typedef struct \{(.*?)\} (vsg_\w+_t);", bare, re.DOTALL):
            sizes[name] = sum(sizes.get(kind, 1) for kind in re.findall(r"(\w+) \w+;", body))
        self.functions = {
            name: [_argument(one, sizes) for one in declared.split(",")] + _returned(returned)
            for returned, name, declared in re.findall(
                r"^static inline (\w+) vsg_(\w+)\(([^)]*)\)", text.functions, re.MULTILINE
            )
        }
        source, library = build / "laws.c", build / "laws.so"
        source.write_text(text.text + "".join(map(_loop, self.functions.items())), encoding="ascii")
        more = ["-O2" if optimised else "-O0", *(["-DVSG_DOUBLE"] if double else [])]
        run_compiler([compiler, *FLAGS, *more, "-shared", "-fPIC", str(source), "-o", str(library), "-lm"])
        self.library = ctypes.CDLL(str(library))

    def __call__(self, name: str, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Outputs of a function for inputs (N, n), flat."""
        width = sum(argument.count for argument in self.functions[name] if argument.role == "out")
        given = np.ascontiguousarray(rows, self.real)
        assert given.shape[1] == sum(a.count for a in self.functions[name] if a.role in ("in", "flag"))
        found = np.full((len(rows), width), np.nan, self.real)
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in (given, found)]
        self.library[f"rows_{name}"](*pointers, ctypes.c_long(len(rows)))
        return found.astype(float)


def _argument(declared: str, sizes: dict[str, int]) -> Argument:
    found = re.fullmatch(r"\s*(const )?(\w+) (\*?)(\w+)", declared)
    assert found is not None, declared
    constant, kind, pointer, name = found.groups()
    role = "lost" if name.endswith("_lost") else ("out" if pointer and not constant else "in")
    return Argument(kind, name, sizes.get(kind, 1), "flag" if kind == "int" else role)


def _returned(kind: str) -> list[Argument]:
    return [] if kind == "void" else [Argument(kind, "", 1, "out")]


def _loop(item: tuple[str, list[Argument]]) -> str:
    name, arguments = item
    before, after, passed, at = "", "", [], {"in": 0, "out": 0}
    result = ""
    for k, one in enumerate(arguments):
        if one.role in ("in", "flag"):
            before += f"        {one.kind} a{k};\n"
            place = f"in[{at['in']}]"
            before += (
                f"        a{k} = {place} > 0;\n"
                if one.role == "flag"
                else f"        memcpy(&a{k}, &{place}, sizeof a{k});\n"
            )
            passed.append(f"&a{k}" if one.kind not in ("vsg_real_t", "int") else f"a{k}")
            at["in"] += one.count
        elif one.role == "lost":
            before += f"        {one.kind} a{k};\n        memset(&a{k}, 0, sizeof a{k});\n"
            passed.append(f"&a{k}")
        else:
            before += f"        {one.kind} a{k};\n"
            after += f"        memcpy(&out[{at['out']}], &a{k}, sizeof a{k});\n"
            at["out"] += one.count
            if one.name:
                passed.append(f"&a{k}")
            else:
                result = f"a{k} = "
    call = f"        {result}vsg_{name}({', '.join(passed)});\n"
    return (
        f"\n#include <string.h>\nvoid rows_{name}(const vsg_real_t *in, vsg_real_t *out, long count);\n"
        f"void rows_{name}(const vsg_real_t *in, vsg_real_t *out, long count)\n{{\n    long k;\n"
        f"    for (k = 0; k < count; ++k) {{\n{before}{call}{after}"
        f"        in += {at['in']};\n        out += {at['out']};\n    }}\n}}\n"
    )
