"""A controller of a study for tools that draw block diagrams: MATLAB, Simulink and Octave (MAT tables, a MEX function,
an S-function and buses), PLECS (the text of a C-Script block, and a library for the DLL block), and Modelica.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign import __version__
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.export.c_code import filled
from vsgdesign.export.port_records import FIXED, Port, plain_unit, refusal
from vsgdesign.export.unit import Unit
from vsgdesign.export.unit_content import lists_of, unit_hash
from vsgdesign.export.wrapping import (
    LINUX,
    WINDOWS,
    Builder,
    Exported,
    Wrapped,
    begun,
    in_one_file,
    meaning_of,
    sources_of,
    write_wrapper,
)

LONGEST_NAME = 40
"""MATLAB cuts names after 63 characters, and the files have endings."""


def export_simulink(
    unit: Unit,
    out: str | Path,
    *,
    variant: str = "controller",
    inputs: Iterable[str | Path] = (),
    builder: Builder | None = None,
) -> Exported:
    """Writes what MATLAB, Simulink and Octave take into the folder ``out``; nothing is compiled here.

    Raises ArtifactError: a folder with other files, an unknown variant.
    """
    inputs = tuple(inputs)
    with begun("simulink", unit, out, variant, inputs, builder, longest=LONGEST_NAME) as (one, used):
        sources = sources_of(unit, used)
    content = content_of_simulink(one, sources)
    names = {
        "mex.c": f"{one.name}_mex.c",
        "sfunction.c": f"{one.name}_sfun.c",
        "build.m": f"{one.name}_build.m",
        "buses.m": f"{one.name}_buses.m",
    }
    files: dict[str, str | bytes] = {place: filled(name, content) for name, place in names.items()}
    files[f"{one.name}_table.mat"] = mat_file(unit)
    files[f"{one.name}_table.m"] = table_script(one)
    files |= {f"sources/{name}": text for name, text in sources.items()}
    return write_wrapper("simulink", one, out, files, inputs=inputs)


def content_of_simulink(one: Wrapped, sources: Mapping[str, str]) -> dict[str, Any]:
    """What the templates are filled with."""
    unit = one.unit
    at_once = one.variant == "controller" and unit.delay_samples == 0
    return {
        "name": one.name,
        "version": __version__,
        "word": one.word,
        "T_s": repr(unit.T_s),
        "at_once": at_once or one.variant == "reference",
        "sha256": unit_hash(unit, lists_of(unit)),
        "inputs": [_port(port) for port in one.ports.inputs],
        "outputs": [_port(port) for port in one.ports.outputs],
        "parameters": [_port(port) for port in one.ports.parameters],
        "sources": sorted(name for name in sources if name.endswith(".c")),
    }


def _port(port: Port) -> dict[str, Any]:
    return {
        "name": port.name,
        "meaning": meaning_of(port).replace("'", "''"),
        "unit": plain_unit(port.unit),
        "fixed": int(port.kind == FIXED),
        "start": repr(port.start),
    }


def table_arrays(unit: Unit) -> dict[str, Any]:
    """The schedule as arrays: the axes, and each normalised parameter with a row for each SCR and a column for each
    R/X, NaN where there is no design; then the ratings, and the gains with which the controller begins."""
    lookup = unit.scheduler.lookup
    shape = len(lookup.scr), len(lookup.r_over_x)
    nodes = np.full((*shape, len(NormalisedGains._fields)), np.nan)
    for row, column in np.ndindex(*shape):
        node = lookup.nodes[row][column]
        if node is not None:
            nodes[row, column] = node
    arrays = {"scr": np.array(lookup.scr), "r_over_x": np.array(lookup.r_over_x)}
    arrays |= {name: nodes[:, :, k] for k, name in enumerate(NormalisedGains._fields)}
    scalars = {
        "S_rated": lookup.S_rated,
        "V_n_rms": lookup.V_n_rms,
        "Z_base": lookup.Z_base,
        "omega": lookup.omega,
        "R_2": lookup.R_2,
        "L_2": lookup.L_2,
        "D_p": lookup.D_p,
        "D_q": lookup.D_q,
        "T_s": unit.T_s,
        "delay_samples": float(unit.delay_samples),
    }
    first = {f"first_{name}": float(value) for name, value in unit.gains._asdict().items()}
    return arrays | {name: float(value) for name, value in (scalars | first).items()}


def texts_of_table(unit: Unit) -> dict[str, str]:
    """What the table is, in words."""
    lookup, origin = unit.scheduler.lookup, unit.origin
    return {
        "structure": lookup.structure,
        "law": lookup.law,
        "scr_basis": lookup.scr_basis,
        "table_sha256": origin.table_sha256,
        "sha256": unit_hash(unit, lists_of(unit)),
    }


def mat_file(unit: Unit) -> bytes:
    """One struct ``vsg`` in a MAT file of version 5, which MATLAB and Octave load."""
    from scipy.io import savemat

    whole = io.BytesIO()
    savemat(whole, {"vsg": table_arrays(unit) | texts_of_table(unit)}, format="5", oned_as="row", do_compression=True)
    return _without_date(whole.getvalue())


def _without_date(content: bytes) -> bytes:
    """The text in front of a MAT file holds the time of writing; the same table gives the same bytes."""
    head = f"MATLAB 5.0 MAT-file, made by vsgdesign {__version__}".encode("ascii")
    return head.ljust(116)[:116] + content[116:]


def table_script(one: Wrapped) -> str:
    """The same struct as a script, for who cannot load binary files."""
    lines = [f"% The schedule of {one.name}. Made by vsgdesign {__version__}."]
    for name, value in table_arrays(one.unit).items():
        rows = np.atleast_2d(value)
        text = ";\n  ".join(", ".join(_number(number) for number in row) for row in rows)
        lines.append(f"vsg.{name} = [{text}];" if rows.size > 1 else f"vsg.{name} = {text};")
    lines += [f"vsg.{name} = '{text}';" for name, text in texts_of_table(one.unit).items()]
    return "\n".join([*lines, ""])


def _number(value: float) -> str:
    return "NaN" if np.isnan(value) else repr(float(value))


PLACES = {LINUX: "{name}_plecs.so", WINDOWS: "{name}_plecs.dll"}


def export_plecs(
    unit: Unit,
    out: str | Path,
    *,
    variant: str = "controller",
    inputs: Iterable[str | Path] = (),
    builder: Builder | None = None,
) -> Exported:
    """Writes the text of a C-Script block, the sources, and libraries for the DLL block into the folder ``out``.

    Raises ArtifactError: a folder with other files, an unknown variant.
    """
    inputs = tuple(inputs)
    with begun("plecs", unit, out, variant, inputs, builder) as (one, used):
        sources = sources_of(unit, used)
        content = content_of_plecs(one, sources)
        own = {"plecs_dll.c": filled("plecs_dll.c", content)}
        files = {f"sources/{name}": text for name, text in (own | sources).items()}
        files[f"{one.name}_cscript.txt"] = filled("plecs_cscript.txt", content)
        libraries, said = used.libraries(one, own, PLACES, "plecs*")
        return write_wrapper("plecs", one, out, files | libraries, inputs=inputs, said=said)


def content_of_plecs(one: Wrapped, sources: Mapping[str, str]) -> dict[str, Any]:
    """What the templates are filled with."""
    unit = one.unit
    made_before = one.variant == "controller" and unit.delay_samples > 0

    def listed(ports: Any) -> list[dict[str, str]]:
        return [
            {"name": port.name, "meaning": meaning_of(port), "unit": plain_unit(port.unit), "start": repr(port.start)}
            for port in ports
        ]

    return {
        "name": one.name,
        "version": __version__,
        "word": one.word,
        "T_s": repr(unit.T_s),
        "made_before": made_before,
        "sha256": unit_hash(unit, lists_of(unit)),
        "inputs": listed(one.ports.inputs),
        "outputs": listed(one.ports.outputs),
        "parameters": listed(one.ports.parameters),
        "states": len(one.ports.states),
        "all_sources": in_one_file(sources, "sources/"),
    }


NO_DESIGN = -1.0
"""Modelica has no NaN: a node without a design has this as its first parameter, as in the exported C."""


def export_modelica(
    unit: Unit,
    out: str | Path,
    *,
    variant: str = "controller",
    inputs: Iterable[str | Path] = (),
    builder: Builder | None = None,
) -> Exported:
    """Writes a package with the schedule, a package with the controller and the C that this calls into the folder
    ``out``.

    Raises ArtifactError: a folder with other files, an unknown variant.
    """
    inputs = tuple(inputs)
    with begun("modelica", unit, out, variant, inputs, builder) as (one, used):
        sources = sources_of(unit, used)
    content = content_of_modelica(one)
    files: dict[str, str | bytes] = {
        f"{content['table']}.mo": filled("table.mo", content),
        f"{content['package']}.mo": filled("controller.mo", content),
        "Resources/Include/vsg_modelica.h": filled("vsg_modelica.h", content),
    }
    files |= {f"Resources/Include/{name}": text for name, text in sources.items() if name.endswith(".h")}
    files |= {f"Resources/Source/{name}": text for name, text in sources.items() if name.endswith(".c")}
    files["Resources/Source/vsg_modelica.c"] = filled("vsg_modelica.c", content)
    files[f"{one.name}_combitable.txt"] = combi_tables(unit)
    return write_wrapper("modelica", one, out, files, inputs=inputs)


def content_of_modelica(one: Wrapped) -> dict[str, Any]:
    """What the templates are filled with."""
    unit = one.unit
    scr, r_over_x, nodes = _axes(unit)
    return {
        "name": one.name,
        "table": f"VsgTable_{one.name}",
        "package": f"VsgController_{one.name}",
        "version": __version__,
        "word": one.word,
        "T_s": repr(unit.T_s),
        "delay": unit.delay_samples,
        "sha256": unit_hash(unit, lists_of(unit)),
        "scr": _row(scr),
        "r_over_x": _row(r_over_x),
        "nodes": {name: _matrix(values) for name, values in nodes.items()},
        "fields": NormalisedGains._fields,
        "lookup": unit.scheduler.lookup,
        "inputs": [_modelica_port(port) for port in one.ports.inputs],
        "outputs": [_modelica_port(port) for port in one.ports.outputs],
        "parameters": [_modelica_port(port) for port in one.ports.parameters],
    }


def _axes(unit: Unit) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Axes of at least two nodes each: a closed form, which is the same everywhere, has its node twice."""
    arrays = table_arrays(unit)
    scr, ratio = arrays["scr"], arrays["r_over_x"]
    nodes = {}
    for name in NormalisedGains._fields:
        values = np.array(arrays[name])
        if name == NormalisedGains._fields[0]:
            values = np.where(np.isnan(values), NO_DESIGN, values)
        values = np.nan_to_num(values)
        values = np.repeat(values, 2, axis=0) if len(scr) == 1 else values
        nodes[name] = np.repeat(values, 2, axis=1) if len(ratio) == 1 else values
    doubled = (np.append(axis, axis[0] + 1.0) if len(axis) == 1 else axis for axis in (scr, ratio))
    scr, ratio = doubled
    return scr, ratio, nodes


def combi_tables(unit: Unit) -> str:
    """The schedule as a text of Modelica.Blocks.Tables.CombiTable2Ds: in each table the first column is SCR and the
    first row R/X. Use LinearSegments and HoldLastPoint."""
    scr, ratio, nodes = _axes(unit)
    lines = ["#1", f"# Made by vsgdesign {__version__}; columns: R/X, rows: SCR."]
    for name, values in nodes.items():
        lines.append(f"double {name}({len(scr) + 1},{len(ratio) + 1})")
        lines.append(" ".join(["0", *(repr(float(value)) for value in ratio)]))
        lines += [" ".join(repr(float(value)) for value in (at, *row)) for at, row in zip(scr, values, strict=True)]
    return "\n".join([*lines, ""])


def _row(values: np.ndarray) -> str:
    return "{" + ", ".join(repr(float(value)) for value in values) + "}"


def _matrix(values: np.ndarray) -> str:
    return "{" + ",\n    ".join(_row(row) for row in values) + "}"


def _modelica_port(port: Port) -> dict[str, Any]:
    unit = plain_unit(port.unit)
    return {
        "name": f"P_meas_{port.name}" if port.name in ("time",) else port.name,
        "meaning": meaning_of(port).replace('"', "'"),
        "unit": unit.lower() if unit == "Ohm" else unit,
        "start": repr(float(port.start)),
        "low": repr(float(port.low)),
        "high": repr(float(port.high)),
        "whole": port.whole,
        "refusal": refusal(port),
    }
