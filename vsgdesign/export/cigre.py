"""A controller of a study as a library with the IEEE/CIGRE interface of TB 958."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from vsgdesign import __version__
from vsgdesign.export.c_code import filled
from vsgdesign.export.port_records import FIXED, Port, plain_unit
from vsgdesign.export.unit import Unit
from vsgdesign.export.unit_content import lists_of, unit_hash
from vsgdesign.export.wrapping import (
    LINUX,
    WINDOWS,
    WINDOWS_32,
    Builder,
    Exported,
    Wrapped,
    begun,
    meaning_of,
    sources_of,
    write_wrapper,
)

PLACES = {LINUX: "{name}.so", WINDOWS: "{name}.dll", WINDOWS_32: "{name}_32.dll"}
NO_LIMIT = 1e30
"""Written where a parameter has no limit."""


def export_dll(
    unit: Unit,
    out: str | Path,
    *,
    variant: str = "controller",
    inputs: Iterable[str | Path] = (),
    builder: Builder | None = None,
) -> Exported:
    """Writes the sources into the folder ``out``, and the library for each system for which there is a compiler.

    Raises ArtifactError: a folder with other files, an unknown variant.
    """
    inputs = tuple(inputs)
    with begun("dll", unit, out, variant, inputs, builder) as (one, used):
        own = {"cigre.c": filled("cigre.c", content_of_dll(one))}
        files = {f"sources/{name}": text for name, text in (sources_of(unit, used) | own).items()}
        libraries, said = used.libraries(one, own, PLACES, "Model_*")
        return write_wrapper("dll", one, out, files | libraries, inputs=inputs, said=said)


def content_of_dll(one: Wrapped) -> dict[str, Any]:
    """What the template is filled with."""
    unit = one.unit
    origin = unit.origin
    reference = one.variant == "reference"
    return {
        "name": one.name,
        "version": __version__,
        "word": one.word,
        "about": _quoted(f"Controller {unit.controller} of study {origin.study}, table {origin.table}"),
        "sha256": unit_hash(unit, lists_of(unit)),
        "T_s": repr(unit.T_s),
        "base_time": "-1.0" if reference else repr(unit.T_s),
        "mode": "2U" if reference else "1U",
        "made_before": not reference and unit.delay_samples > 0,
        "inputs": [_port(port) for port in one.ports.inputs],
        "outputs": [_port(port) for port in one.ports.outputs],
        "parameters": [_port(port) for port in one.ports.parameters],
    }


def _port(port: Port) -> dict[str, Any]:
    """A port as the template takes it. In these tools a controller begins on a live bus unless it is told to rest."""
    return {
        "name": port.name,
        "meaning": _quoted(meaning_of(port)),
        "unit": plain_unit(port.unit),
        "fixed": int(port.kind == FIXED),
        "start": repr(1.0 if port.name == "start" else port.start),
        "low": repr(max(port.low, -NO_LIMIT)),
        "high": repr(min(port.high, NO_LIMIT)),
    }


def _quoted(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')
