"""A controller of a study for Modelica: the schedule in pure Modelica, and the controller as a block of external C."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign import __version__
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.export.c_code import filled
from vsgdesign.export.port_records import Port, plain_unit, refusal
from vsgdesign.export.simulink import table_arrays
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
        "inputs": [_port(port) for port in one.ports.inputs],
        "outputs": [_port(port) for port in one.ports.outputs],
        "parameters": [_port(port) for port in one.ports.parameters],
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


def _port(port: Port) -> dict[str, Any]:
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
