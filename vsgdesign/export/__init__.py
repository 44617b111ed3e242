"""Exports for the controller: C99 and ONNX from gain tables and weights."""

from vsgdesign.export.c_code import ExportedC, export_c, export_c_files
from vsgdesign.export.c_content import initialiser
from vsgdesign.export.compiled import CompiledC, compile_c
from vsgdesign.export.numbers import converter_numbers

__all__ = ["CompiledC", "ExportedC", "compile_c", "converter_numbers", "export_c", "export_c_files", "initialiser"]
