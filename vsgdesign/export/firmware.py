"""A controller of a study as a bare-metal project for Cortex-M4F and M7."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from vsgdesign import __version__
from vsgdesign.export.c_code import filled, render_unit
from vsgdesign.export.unit import Unit
from vsgdesign.export.wrapping import Builder, Exported, check_target, wrapped, write_wrapper

FILES = {
    "main.c": "firmware_main.c",
    "startup.c": "firmware_startup.c",
    "drivers.h": "firmware_drivers.h",
    "drivers.c": "firmware_drivers.c",
    "test.c": "firmware_test.c",
    "pil.c": "firmware_pil.c",
    "Makefile": "firmware_Makefile",
}
"""Files of the project and their templates."""

CORES = {"m4.ld": "Cortex-M4F", "m7.ld": "Cortex-M7"}


def export_firmware(
    unit: Unit, out: str | Path, *, inputs: Iterable[str | Path] = (), builder: Builder | None = None
) -> Exported:
    """Writes a project into the folder ``out``: the sources, start-up, linker scripts, and drivers to be filled in.

    Nothing is compiled here. Raises ArtifactError for a folder with other files.
    """
    inputs = tuple(inputs)
    check_target("firmware", out, inputs)
    one = wrapped(unit, "controller")
    content = {"name": one.name, "version": __version__, "T_s": repr(unit.T_s), "delay": unit.delay_samples}
    texts = render_unit(unit) if builder is None else builder.texts(unit)
    files: dict[str, str | bytes] = {name: filled(template, content) for name, template in FILES.items()}
    files |= {name: filled("firmware.ld", content | {"core": core}) for name, core in CORES.items()}
    files |= {f"sources/{name}": text for name, text in texts.items() if name.endswith((".c", ".h"))}
    return write_wrapper("firmware", one, out, files, inputs=inputs)
