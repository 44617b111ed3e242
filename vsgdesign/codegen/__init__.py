"""One source for several targets: plain functions of numbers become C99, or machine code of many lanes.

This package knows NumPy, llvmlite and the syntax of Python, and nothing of what its functions compute. It reads their
source, so a function must keep to a restricted language (:mod:`~vsgdesign.codegen.language`). Everything else is
refused with file, line and what to write instead.

- What a value is stands in its hint: ``Any`` or ``float`` a number, ``bool`` a flag, a NamedTuple a record,
  ``Annotated[int, "count"]`` a whole number of 32 bits, ``Annotated[tuple[float, ...], "numbers"]`` a row of constants.
  A function that returns ``Annotated[Any, "integrated"]`` moves an integrator: each target has its own.
- :mod:`~vsgdesign.codegen.reader` makes expressions and statements of a function
  (:mod:`~vsgdesign.codegen.expressions`), with everything folded that is known.
- :func:`c_functions` prints them as C99 for either precision, with the comments of the source.
- :func:`~vsgdesign.codegen.llvm.flat_block` makes one straight line of a function and all that it calls. Blocks are
  joined (:mod:`~vsgdesign.codegen.blocks`) and compiled:
  :class:`~vsgdesign.codegen.llvm.LoopSpec` says where each of their numbers comes from, and
  :func:`~vsgdesign.codegen.llvm.compiled_loop` makes a loop over samples and lanes of them. A strict loop has the bits
  of plain Python.
- The target of machine code is a value, :class:`~vsgdesign.codegen.machine_code.Target`: AVX-512, AVX2 or SSE2 in this
  process, WebAssembly for another one. A new target is one more of them. :func:`~vsgdesign.codegen.wasm.wasm_module`
  makes a module of several loops.
"""

from vsgdesign.codegen.c99 import TYPES, CText, c_functions
from vsgdesign.codegen.language import UntranslatableError

__all__ = ["TYPES", "CText", "UntranslatableError", "c_functions"]
