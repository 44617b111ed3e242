"""Write a study from a datasheet: a text that says for every line where it comes from and what may be changed."""

from __future__ import annotations

import json
import math
import textwrap

from vsgdesign.study.datasheet.resolving import Datasheet
from vsgdesign.study.parameters.reader import format_quantity

_NODES = 6
"""Number of nodes of the table on each axis, to begin with."""

_WIDTH = 118


def study_text(sheet: Datasheet, origin: str) -> str:
    """The study as TOML. ``origin`` says where the data come from: the name of a file, or the terminal."""
    parts = (
        _head(sheet, origin),
        _converter(sheet),
        _filter(sheet),
        *_dc(sheet),
        _INNER,
        _grid(sheet),
        _power_loops(sheet),
        _specification(sheet),
        _CONTROLLERS,
        _scenario(sheet),
    )
    return "\n".join(parts)


def _head(sheet: Datasheet, origin: str) -> str:
    lines = _comment(f"{sheet.title}: written by `vsgdesign new` from {origin}.")
    lines += [
        "#",
        "# vsgdesign run FILE     inner loops, gain table with its certificate, scenario, report, C",
        "# vsgdesign inner FILE   the inner loops alone, and what limits them",
        "#",
    ]
    if sheet.assumptions:
        lines.append("# The datasheet does not say, so this is assumed. Correct what you know better:")
        for assumption in sheet.assumptions:
            lines += _comment(f"{assumption.field}: {assumption.text}", "#   - ", "#     ")
    else:
        lines.append("# Everything below that a datasheet can say is the datasheet's own.")
    for note in sheet.notes:
        lines += _comment(f"Note: {note}.")
    if sheet.unused:
        lines += _comment("Not used of the datasheet: " + ", ".join(sheet.unused) + ".")
    lines += ["schema = 1", "", "[study]", f"title = {_quoted(sheet.title)}"]
    lines.append(f"source = {_quoted(sheet.source or f'datasheet {origin}')}")
    return "\n".join(lines) + "\n"


def _converter(sheet: Datasheet) -> str:
    lines = [
        "[converter]",
        _line(sheet, "S_rated", format_quantity(sheet.S_rated, "VA")),
        _line(sheet, "V_rated_ll_rms", format_quantity(sheet.V_rated_ll_rms, "V")),
        _line(sheet, "f_n", format_quantity(sheet.f_n, "Hz")),
        _line(sheet, "V_dc", format_quantity(sheet.V_dc, "V")),
        _line(sheet, "f_sw", format_quantity(sheet.f_sw, "Hz")),
        _line(sheet, "samples_per_carrier", sheet.samples_per_carrier),
        _line(sheet, "delay_samples", sheet.delay_samples),
        _line(sheet, "modulation", sheet.modulation),
        _line(sheet, "current_limit_pu", float(f"{sheet.current_limit_pu:.6g}"), "of the rated peak current"),
        _line(sheet, "current_limiter", "projection", "survives jumps of the grid and faults at the limit"),
    ]
    return "\n".join(lines) + "\n"


def _filter(sheet: Datasheet) -> str:
    lines = [
        "[filter]",
        _line(sheet, "kind", "LCL" if sheet.L_2 > 0.0 else "LC"),
        _line(sheet, "L_1", format_quantity(sheet.L_1, "H")),
        _line(sheet, "R_1", format_quantity(sheet.R_1, "ohm")),
        _line(sheet, "C", format_quantity(sheet.C, "F"), "star"),
        _line(sheet, "R_c", format_quantity(sheet.R_c, "ohm")),
    ]
    if sheet.L_2 > 0.0:
        lines.append(_line(sheet, "L_2", format_quantity(sheet.L_2, "H")))
        lines.append(_line(sheet, "R_2", format_quantity(sheet.R_2, "ohm")))
    return "\n".join(lines) + "\n"


def _dc(sheet: Datasheet) -> tuple[str, ...]:
    if sheet.dc is None:
        return ()
    lines = [
        "[dc]",
        _line(sheet, "source", "converter", "behind a dc-dc stage"),
        _line(sheet, "C", format_quantity(sheet.dc.C, "F"), "vsgdesign size FILE finds the least one"),
        _line(sheet, "control", "power_clamp", "asks for no more than the source can give"),
        "",
        "[dc.converter]",
        _line(sheet, "p_max", format_quantity(sheet.dc.power, "W")),
        _line(sheet, "p_charge_max", format_quantity(sheet.dc.charge_power, "W")),
    ]
    if sheet.dc.energy is not None:
        lines += [_line(sheet, "energy", sheet.dc.energy, "J"), _line(sheet, "charge", 0.5, "of it at the start")]
    return ("\n".join(lines) + "\n",)


_INNER = """\
[inner_loops]
design = true                    # designed once from the data above, over the grids below, and kept in a file
"""

_CONTROLLERS = """\
[[controllers]]
name = "table"
kind = "scheduled"
schedule = "table"               # designed by `run` or `table build` to the specification above
# estimate = "neural"            # from an estimate of the grid in place of the truth; needs the section below

# A network that estimates the grid, trained in the run: half a minute more, and PyTorch. It is lent the phase of the
# grid's own voltage, which a simulator has and no converter in the field. It learns P from 0.3 to 0.9 pu: at less, as
# in the first second of this scenario, its estimates are rough.
# [estimator]
# recipe = "wide"
# grid_phase = true
"""


def _grid(sheet: Datasheet) -> str:
    return f"""\
[grid]                           # where the scenario begins: the middle of the grids below
scr = {middle(sheet.scr):.6g}
x_over_r = {middle(sheet.x_over_r):.6g}
"""


def _power_loops(sheet: Datasheet) -> str:
    return f"""\
[power_loops]
structure = "angle_damped"
tau_P = "5 ms"                   # filters of the measured powers
tau_Q = "5 ms"
# power_filter = "notch"         # and 3.4 ms in place of 5 ms: for a grid with much negative sequence
P_droop = "5 %"                  # of nominal frequency, for rated power
Q_droop = "50 %"                 # soft: what a wrong estimate of the grid may do to V stays small
P_design = "{_power(0.5 * sheet.S_rated, "W")}"
Q_design = "0 var"
"""


_ERROR_Z = 0.08
"""Error of the estimate in any direction that a new study asks for: it costs little, and an estimator of a real grid
needs it (docs/how-to/design-a-table.md)."""


def _specification(sheet: Datasheet) -> str:
    scr, x_over_r = nodes(sheet.scr), nodes(sheet.x_over_r)
    P, Q = _power(0.9 * sheet.S_rated, "W"), _power(0.4 * sheet.S_rated, "var")
    remark = f"   # {sheet.remarks['scr']}" if "scr" in sheet.remarks else ""
    error_Z = min(_ERROR_Z, float(f"{0.5 * math.sin(math.atan(x_over_r[0])):.1g}"))  # X̂ has to stay positive
    return f"""\
[specification]                  # what the table keeps, at the worst of everything below
settling_time = "1.3 s"          # 2 % band, P and Q
overshoot = "5 %"
disk_margin = 1.0
damping_ratio = 0.5
P = ["-{P}", "{P}"]
Q = ["-{Q}", "{Q}"]
error = "20 %"                   # of the estimates of R_g and of L_g, each either way
error_Z = "{100.0 * error_Z:g} %"                  # and of |Z_g| in any direction, where that is more
scr = [{", ".join(f"{value:.6g}" for value in scr)}]{remark}
x_over_r = [{", ".join(f"{value:.6g}" for value in x_over_r)}]
"""


def _scenario(sheet: Datasheet) -> str:
    """Steps of P and Q on the medium, the weakest and the strongest grid. Each is possible with some reserve."""
    step = 0.2 * sheet.S_rated * min(1.0, sheet.scr[0] / 1.5)
    scr = middle(sheet.scr)
    events = [
        (1, f'P_ref = "{_power(2.0 * step, "W")}"'),
        (5, f"grid = {{ scr = {sheet.scr[0]:.6g} }}"),
        (9, f'Q_ref = "{_power(0.5 * step, "var")}"'),
        (13, f"grid = {{ scr = {scr:.6g} }}"),
        (17, f"grid = {{ scr = {sheet.scr[1]:.6g} }}"),
        (21, f'P_ref = "{_power(1.5 * step, "W")}"'),
    ]
    text = f"""\
[simulation]
duration = "25 s"
P_ref = "{_power(step, "W")}"
Q_ref = "0 var"
"""
    return text + "".join(f'\n[[events]]\ntime = "{time} s"\n{change}\n' for time, change in events)


def middle(ends: tuple[float, float]) -> float:
    """The geometric mean of a range, to two digits."""
    return min(max(float(f"{math.sqrt(ends[0] * ends[1]):.2g}"), ends[0]), ends[1])


def nodes(ends: tuple[float, float]) -> list[float]:
    """Values evenly spaced in the logarithm, including both ends; around a single value, one fifth to either side."""
    low, high = ends if ends[1] > ends[0] * 1.02 else (ends[0] / 1.25, ends[0] * 1.25)
    count = min(_NODES, max(2, 1 + math.ceil(math.log(high / low) / math.log(1.8))))
    inner = [float(f"{low * (high / low) ** (k / (count - 1)):.2g}") for k in range(1, count - 1)]
    return [low, *(value for value in inner if low < value < high), high]


def _power(value: float, base: str) -> str:
    return format_quantity(float(f"{value:.4g}"), base)


def _line(sheet: Datasheet, field: str, value: str | float, remark: str = "") -> str:
    shown = _quoted(value) if isinstance(value, str) else repr(value)
    remark = sheet.remarks.get(field, remark)
    text = f"{field} = {shown}"
    return f"{text:<32} # {one_line(remark)}" if remark else text


def _quoted(text: str) -> str:
    """A text for TOML, which has the escapes of JSON."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def one_line(text: str) -> str:
    """A text that can stand in a comment, whatever the file contains."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _comment(text: str, first: str = "# ", further: str = "# ") -> list[str]:
    return textwrap.wrap(
        one_line(text),
        _WIDTH,
        initial_indent=first,
        subsequent_indent=further,
        break_long_words=False,
        break_on_hyphens=False,
    )
