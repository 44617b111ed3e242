"""Reads the [specification] section: what a designed gain table has to keep, and over what."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from vsgdesign.equations.grid import MOST_ERROR_Z, SCR_BASES
from vsgdesign.parameters.converter import Converter
from vsgdesign.parameters.reader import TableReader
from vsgdesign.parameters.source import GridSource
from vsgdesign.parameters.study import ClosedFormTarget

AIMS = ("settling", "inertia")

_BOTH = 'Leave it out; or, for a given speed and inertia at once, set aim = "settling" with H_min and H_max.'
_NOT_WITH_INERTIA = {"settling_time": _BOTH, "overshoot": _BOTH, "H_min": "Give H alone.", "H_max": "Give H alone."}
"""Fields that would stand back in silence, and what to do instead."""

UNBOUNDED_H = 1e6
"""H_max where none is asked for, s."""

DEFAULT_SCR = (1.5, 2.0, 3.0, 5.0, 10.0, 20.0)
DEFAULT_X_OVER_R = (0.5, 1.0, 2.0, 5.0, 20.0)


@dataclass(frozen=True)
class DesignBox:
    """Everything that may differ from a cell's nominal: the design keeps its promises over all combinations of the
    limits (and at P = Q = 0 where that lies inside)."""

    P: tuple[float, ...]
    """W, at the control point."""
    Q: tuple[float, ...]
    error_R: float
    error_X: float
    """Relative errors of the estimate of R_g and of L_g, each either sign."""
    omega_g: tuple[float, ...]
    """Grid frequency, rad/s."""
    V_g_rms: tuple[float, ...]
    """Phase rms, V."""
    error_Z: float = 0.0
    """Error of the estimate in any direction, relative to \\|Z_g\\|. The larger of the two kinds counts
    (:func:`vsgdesign.equations.grid.error_half_widths`)."""

    @property
    def errors(self) -> tuple[float, float, float]:
        """error_R, error_X and error_Z."""
        return self.error_R, self.error_X, self.error_Z

    def exact(self) -> DesignBox:
        """The same box with an exact estimate."""
        return replace(self, error_R=0.0, error_X=0.0, error_Z=0.0)


@dataclass(frozen=True, kw_only=True)
class Specification:
    """What a gain table must keep in every cell, at the worst of the box. Limits that are None are not asked."""

    aim: str
    """``settling``: poles are free, inertia is what is left. ``inertia``: H is held, settling is what is left."""
    settling_time: float
    """True 2 % settling of P and Q after a step of their own reference, s. For ``inertia`` the time scale only."""
    overshoot: float
    """Of the step."""
    damping_ratio: float
    """Least, over every mode."""
    disk_margin: float
    """Least balanced 2×2 disk margin; gain and phase margins asked for are part of it."""
    H: float | None
    """Inertia constant to hold, s (aim ``inertia``)."""
    H_min: float
    H_max: float
    """Bounds on the inertia constant, s, at the design point."""
    bandwidth_max: float
    """Upper bound of k_2, the voltage loop's pole, and of d_1, 1/s."""
    scr_basis: str
    """What SCR means on the table's axis: ``impedance`` or ``reactance``."""
    scr: tuple[float, ...]
    x_over_r: tuple[float, ...]
    """Nodes of the table to begin with; nodes are added where interpolation breaks a promise."""
    box: DesignBox

    @property
    def settles(self) -> bool:
        """Whether settling time and overshoot are promises."""
        return self.aim == "settling"


def read_specification(
    table: TableReader | None, converter: Converter, source: GridSource, target: ClosedFormTarget, scr_basis: str
) -> Specification | None:
    """The section; None where a study has none."""
    if table is None:
        return None
    aim = table.choice("aim", AIMS, default="settling")
    if aim == "settling" and table.has("H"):
        table.fault("H", table.table["H"], 'is for aim = "inertia" only', 'Set aim = "inertia", or use H_min, H_max.')
        table.quantity("H", "s")
    if aim == "inertia":
        for field, advice in _NOT_WITH_INERTIA.items():
            if table.has(field):
                table.fault(field, table.table[field], 'is not kept with aim = "inertia", where H is', advice)
    gain_db = table.quantity("gain_margin_db", "1", 0.0, 60.0, default=0.0)
    phase_deg = table.quantity("phase_margin_deg", "1", 0.0, 89.0, default=0.0)
    disk = table.quantity("disk_margin", "1", 0.0, 1.9, default=1.0)
    limit = 2.0 * converter.S_rated
    error = table.quantity("error", "1", 0.0, 0.9, default=0.0)
    if table.has("error") and table.has("error_R") and table.has("error_X"):
        table.fault(
            "error",
            table.table["error"],
            "has no effect, because error_R and error_X are both given",
            "Leave one of the three out.",
        )
    omega_g = tuple(2.0 * math.pi * f for f in table.quantities("f_g", "Hz", 10.0, 1000.0, (_hz(source.omega_g),)))
    V_g_pu = table.quantities("V_g_pu", "1", 0.5, 1.5, (source.V_g_rms / converter.V_rated_rms,))
    box = DesignBox(
        P=table.quantities("P", "W", -limit, limit, (target.P,)),
        Q=table.quantities("Q", "var", -limit, limit, (target.Q,)),
        error_R=table.quantity("error_R", "1", 0.0, 0.9, default=error),
        error_X=table.quantity("error_X", "1", 0.0, 0.9, default=error),
        omega_g=omega_g,
        V_g_rms=tuple(v * converter.V_rated_rms for v in V_g_pu),
        error_Z=table.quantity("error_Z", "1", 0.0, MOST_ERROR_Z, default=0.0),
    )
    x_over_r = table.quantities("x_over_r", "1", 1e-3, 1e4, DEFAULT_X_OVER_R)
    H_min = table.quantity("H_min", "s", 0.0, 1e3, default=0.0)
    specification = Specification(
        aim=aim,
        settling_time=table.quantity("settling_time", "s", 1e-3, 1e3, default=target.settling_time),
        overshoot=table.quantity("overshoot", "1", 0.001, 1.0, default=0.05),
        damping_ratio=table.quantity("damping_ratio", "1", 0.0, 1.0, default=0.5),
        disk_margin=max(disk, margin_of(gain_db, phase_deg)),
        H=table.quantity("H", "s", 1e-3, 1e3) if aim == "inertia" else None,
        H_min=H_min,
        H_max=table.quantity("H_max", "s", H_min, 1e6, default=UNBOUNDED_H),
        bandwidth_max=table.quantity("bandwidth_max", "1/s", 1e-2, 1e5, default=0.1 / converter.T_s),
        scr_basis=table.choice("scr_basis", tuple(SCR_BASES), default=scr_basis),
        scr=table.quantities("scr", "1", 0.05, 1e4, DEFAULT_SCR),
        x_over_r=x_over_r,
        box=box,
    )
    for name in ("scr", "x_over_r"):
        if len(getattr(specification, name)) < 2:
            table.fault(name, getattr(specification, name), "a table needs at least two nodes on each axis")
    lowest = min(x_over_r, default=math.inf)
    if box.error_Z >= (share := math.sin(math.atan(lowest))):
        problem = f"leaves no inductance in an estimate at X/R {lowest:g}: must be less than {share:.3g}"
        table.fault("error_Z", box.error_Z, problem, "Begin x_over_r higher, or ask for less.")
    table.finish()
    return specification


def margin_of(gain_db: float, phase_deg: float) -> float:
    """The disk margin that guarantees a gain and a phase margin (:eq:`guaranteed-margins`)."""
    gain = 10.0 ** (gain_db / 20.0)
    return max(2.0 * (gain - 1.0) / (gain + 1.0), 2.0 * math.tan(0.5 * math.radians(phase_deg)))


def _hz(omega: float) -> float:
    return omega / (2.0 * math.pi)
