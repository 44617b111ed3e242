"""One source for other languages: the functions of ``equations`` and ``frames``, read and printed as C99."""

from vsgdesign.codegen.c99 import TYPES, CText, c_functions
from vsgdesign.codegen.source import UntranslatableError

__all__ = ["TYPES", "CText", "UntranslatableError", "c_functions"]
