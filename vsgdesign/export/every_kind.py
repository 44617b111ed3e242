"""A controller of a study in every form at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.guarded_file import staged_folder, write_record
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.export.block_diagrams import export_modelica, export_plecs, export_simulink
from vsgdesign.export.c_code import MANIFEST, export_unit_c
from vsgdesign.export.cigre import export_dll
from vsgdesign.export.firmware import export_firmware
from vsgdesign.export.fmu import export_fmu
from vsgdesign.export.sunspec import export_sunspec
from vsgdesign.export.unit import Unit
from vsgdesign.export.wrapping import Builder, Exported, made_for, wrapped

KINDS: dict[str, Callable[..., Exported]] = {
    "fmu": partial(export_fmu, variant="controller"),
    "fmu-reference": partial(export_fmu, variant="reference"),
    "fmu2": partial(export_fmu, variant="controller", version="2"),
    "fmu2-reference": partial(export_fmu, variant="reference", version="2"),
    "dll": partial(export_dll, variant="controller"),
    "dll-reference": partial(export_dll, variant="reference"),
    "simulink": partial(export_simulink, variant="controller"),
    "plecs": partial(export_plecs, variant="controller"),
    "modelica": partial(export_modelica, variant="controller"),
    "firmware": export_firmware,
    "sunspec": export_sunspec,
}
"""The folders of an export of every kind, beside that of the C."""


def export_all(
    unit: Unit,
    out: str | Path,
    *,
    inputs: Iterable[str | Path] = (),
    builder: Builder | None = None,
    progress: Progress | None = None,
) -> Exported:
    """Writes a controller in every form, each in a folder of its own below ``out``, and ``c`` for the C alone.

    Every controller is compiled once for each system. ``progress`` is told each kind. Raises ArtifactError as each kind
    does.
    """
    out, inputs, said, tell = Path(out), tuple(inputs), [], progress or silent
    whole: dict[str, Any] = made_for(wrapped(unit, "controller"))
    if builder is None:
        with Builder() as own:
            return export_all(unit, out, inputs=inputs, builder=own, progress=progress)
    with staged_folder(out, "vsgdesign export all", inputs=inputs, record=MANIFEST) as folder:
        export_unit_c(unit, folder / "c")
        for name, write in KINDS.items():
            tell(f"write {name}", 0.0)
            said += write(unit, folder / name, builder=builder).said
            tell(f"write {name}", 1.0)
        manifest = write_record(folder, plain(whole | {"kinds": ["c", *KINDS]}), "vsgdesign export all", MANIFEST)
    return Exported(out, manifest, tuple(dict.fromkeys(said)))
