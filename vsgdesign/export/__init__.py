"""Exports for the controller: C99 and ONNX from gain tables and weights, and wrappers for other tools."""

from vsgdesign.export.block_diagrams import export_modelica, export_plecs, export_simulink
from vsgdesign.export.c_code import ExportedC, export_c, export_c_files, export_unit_c
from vsgdesign.export.c_content import initialiser
from vsgdesign.export.cigre import export_dll
from vsgdesign.export.compiled import CompiledC, compile_c
from vsgdesign.export.every_kind import export_all
from vsgdesign.export.field import converter_numbers
from vsgdesign.export.firmware import export_firmware
from vsgdesign.export.fmu import export_fmu
from vsgdesign.export.sunspec import export_sunspec
from vsgdesign.export.unit import Unit, unit_of
from vsgdesign.export.wrapping import Exported

__all__ = [
    "CompiledC",
    "Exported",
    "ExportedC",
    "Unit",
    "compile_c",
    "converter_numbers",
    "export_all",
    "export_c",
    "export_c_files",
    "export_dll",
    "export_firmware",
    "export_fmu",
    "export_modelica",
    "export_plecs",
    "export_simulink",
    "export_sunspec",
    "export_unit_c",
    "initialiser",
    "unit_of",
]
