"""A controller of a study for PLECS: the text of a C-Script block, and a library for the DLL block."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from vsgdesign import __version__
from vsgdesign.export.c_code import filled
from vsgdesign.export.port_records import plain_unit
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
