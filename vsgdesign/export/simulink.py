"""A controller of a study for MATLAB, Simulink and Octave: MAT tables, a MEX function, an S-function and buses."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign import __version__
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.export.c_code import filled
from vsgdesign.export.port_records import FIXED, Port, plain_unit
from vsgdesign.export.unit import Unit
from vsgdesign.export.unit_content import lists_of, unit_hash
from vsgdesign.export.wrapping import (
    Builder,
    Exported,
    Wrapped,
    begun,
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
