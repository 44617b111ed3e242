"""Flash, RAM and stack of the exported C on a Cortex-M4F, measured with arm-none-eabi-gcc."""

from __future__ import annotations

import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from vsgdesign.export.compiled import STRICT, run_compiler

COMPILER = "arm-none-eabi-gcc"
TARGET = (
    "-mcpu=cortex-m4",
    "-mthumb",
    "-mfpu=fpv4-sp-d16",
    "-mfloat-abi=hard",
    "-Os",
    "-ffunction-sections",
    "-fdata-sections",
)
LINK = ("--specs=nano.specs", "--specs=nosys.specs", "-nostartfiles", "-Wl,--gc-sections", "-Wl,-e,main")

_MAIN = """#include "vsg.h"
static vsg_scheduler_t s;
static vsg_power_t p;
{window}
vsg_answer_t a;
vsg_voltage_t u;
volatile vsg_real_t x[8];
int main(void)
{{
    const vsg_references_t refs = {{x[0], x[1], x[2], x[3]}};
    vsg_init(&s);
    vsg_power_init(&p, &s.gains, &refs, x[4], x[5], x[5]);
    for (;;) {{
        vsg_power_step(&p, x[6], x[7], &u);
        vsg_update_estimate(&s, x[0], x[1], p.P_f, p.Q_f, p.V_rms, (uint32_t)x[2], &a);
{pushed}
        vsg_power_retune(&p, &a.gains);
    }}
}}
"""


@dataclass(frozen=True)
class Footprint:
    """Bytes. ``flash``: code and constants, with what they take of the C library. ``ram``: one scheduler and one set of
    power loops; ``window`` the samples; ``stack`` of the deepest call, without interrupts. ``control``: flash, RAM and
    stack of the whole controller's step, which is not in the others; cosf, sinf and sqrtf are the C library's."""

    flash: int
    ram: int
    window: int
    stack: int
    control: tuple[int, int, int]


def measure_footprint(folder: str | Path) -> Footprint:
    """The footprint of an exported folder in single precision. Raises ArtifactError without the compiler."""
    folder = Path(folder)
    network = "vsg_window_t" in (folder / "vsg.h").read_text(encoding="utf-8")
    text = _MAIN.format(
        window="static vsg_window_t w;" if network else "",
        pushed="        (void)vsg_push(&w, (const vsg_real_t *)&x[0], (const vsg_real_t *)&x[1]);\n"
        "        vsg_update_pushed(&s, &w, p.P_f, p.Q_f, p.V_rms, (uint32_t)x[2], &a);"
        if network
        else "",
    )
    with tempfile.TemporaryDirectory(prefix="vsg") as name:
        build = Path(name)
        (build / "main.c").write_text(text, encoding="utf-8")
        (build / "control.c").write_text('#include "vsg.h"\nvsg_control_t c;\n', encoding="utf-8")
        objects, stacks = [], {}
        for source in ("vsg.c", "vsg_data.c", "vsg_power.c", "vsg_control.c"):
            made = build / f"{source}.o"
            run_compiler([COMPILER, *STRICT, *TARGET, "-fstack-usage", "-c", str(folder / source), "-o", str(made)])
            objects.append(str(made))
            usage = made.with_suffix(".su")
            if usage.is_file():
                found = re.findall(r":(\w+)\t(\d+)\t", usage.read_text(encoding="utf-8"))
                stacks |= {function: int(size) for function, size in found}
        program = build / "program"
        run_compiler(
            [COMPILER, *TARGET, f"-I{folder}", str(build / "main.c"), *objects, *LINK, "-lm", "-o", str(program)]
        )
        sizes = run_compiler(["arm-none-eabi-nm", "-S", "-t", "d", str(program)])
        run_compiler([COMPILER, *TARGET, f"-I{folder}", "-c", str(build / "control.c"), "-o", str(build / "control.o")])
        control_sizes = run_compiler(["arm-none-eabi-nm", "-S", "-t", "d", objects[-1], str(build / "control.o")])
        text_bytes, data, _ = map(int, run_compiler(["arm-none-eabi-size", str(program)]).split("\n")[1].split()[:3])
    held, step = _sizes(sizes), _sizes(control_sizes)
    deepest = ("vsg_update_pushed", "vsg_update", "vsg_estimate", "vsg_layer")
    advance = ("vsg_update_pushed", "vsg_update", "vsg_advance", "vsg_updated", "vsg_followed")
    stack = max(sum(stacks.get(name, 0) for name in chain) for chain in (deepest, advance))
    control = step["vsg_control_step"], step["c"], stacks["vsg_control_step"]
    return Footprint(text_bytes + data - held["main"], held["s"] + held["p"], held.get("w", 0), stack, control)


def _sizes(said: str) -> dict[str, int]:
    """Bytes by symbol, from the output of nm."""
    return {m[2]: int(m[1]) for m in re.finditer(r"^\d+ (\d+) \w (\w+)$", said, re.MULTILINE)}


class FieldFootprint(NamedTuple):
    """Bytes of the field estimator alone. ``flash``: its code and constants, ``ram``: its state with the waiting
    samples, ``stack`` of a sample and of a conclusion, without interrupts; the C library is not counted."""

    flash: int
    ram: int
    stack_sample: int
    stack_conclude: int


def measure_field_footprint(folder: str | Path) -> FieldFootprint:
    """The footprint of the estimator in an exported folder that has it. Raises ArtifactError without the compiler."""
    folder = Path(folder)
    with tempfile.TemporaryDirectory(prefix="vsg") as name:
        build = Path(name)
        (build / "state.c").write_text('#include "vsg.h"\nvsg_field_t f;\n', encoding="utf-8")
        made, state = build / "vsg_field.o", build / "state.o"
        source = str(folder / "vsg_field.c")
        run_compiler([COMPILER, *STRICT, *TARGET, "-fstack-usage", "-c", source, "-o", str(made)])
        run_compiler([COMPILER, *TARGET, f"-I{folder}", "-c", str(build / "state.c"), "-o", str(state)])
        run_compiler([COMPILER, *TARGET, "-c", str(folder / "vsg_data.c"), "-o", str(build / "data.o")])
        text = int(run_compiler(["arm-none-eabi-size", str(made)]).split("\n")[1].split()[0])
        constants = _sizes(run_compiler(["arm-none-eabi-nm", "-S", "-t", "d", str(build / "data.o")]))
        ram = _sizes(run_compiler(["arm-none-eabi-nm", "-S", "-t", "d", str(state)]))["f"]
        usage = made.with_suffix(".su").read_text(encoding="utf-8")
    stacks = {function: int(size) for function, size in re.findall(r":(\w+)[.\w]*\t(\d+)\t", usage)}
    text += sum(size for symbol, size in constants.items() if symbol.startswith("vsg_field_"))
    inner = max(size for function, size in stacks.items() if function not in _OUTER)
    return FieldFootprint(
        flash=text,
        ram=ram,
        stack_sample=stacks["vsg_field_listen"] + stacks.get("vsg_field_take", 0),
        stack_conclude=stacks["vsg_field_conclude"] + stacks.get("vsg_conclude", 0) + inner,
    )


_OUTER = ("vsg_field_conclude", "vsg_conclude", "vsg_first_track", "vsg_field_listen", "vsg_field_take")
"""Functions that no other one below a conclusion calls."""
