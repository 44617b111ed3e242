"""The limits of a scheduler, and its status bits and reasons in words (:doc:`docs/theory/runtime.md`)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.equations.frames import rated_current_rms
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.scheduler_data import (
    CLAMPED,
    DOUBT,
    FALLBACK,
    FRESH,
    HELD,
    LIMITED,
    PARTLY,
    REFUSED,
    SchedulerLimits,
)
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.errors import ArtifactError
from vsgdesign.runtime.error_set import NOT_DESIGNED, ErrorSet, error_set_of

if TYPE_CHECKING:
    from vsgdesign.artifacts.gain_table import GainTable

STATUSES = {
    FRESH: "fresh",
    HELD: "held",
    CLAMPED: "clamped",
    LIMITED: "limited",
    FALLBACK: "fallback",
    REFUSED: "refused",
    DOUBT: "doubt",
    PARTLY: "partly",
}
"""Bits of a status. Every answer is either fresh (an estimate was accepted) or held (no estimate was accepted)."""

REASONS = (
    "",
    "time went backwards",
    "a sample or a measurement is not a number",
    "P, Q or V is beyond what can be measured",
    "a sample is at its sensor's limit",
    "there was no estimate",
    "the estimate is outside what is plausible",
    "the estimate jumped and waits to be confirmed",
    "the table has no design at the place",
)
"""Reasons why an estimate was not accepted, in the order of their numbers in
:mod:`vsgdesign.equations.scheduler_data`."""

Pair = tuple[float, float]

_TICKS_LIMIT = 2**31
"""A difference of the 32-bit counter of this size or more means that time went backwards."""


def status_text(status: int) -> str:
    """The names of the bits of a status, for people to read."""
    return " ".join(name for bit, name in STATUSES.items() if status & bit)


@dataclass(frozen=True, kw_only=True)
class SchedulerSettings:
    """Limits of a scheduler. :func:`settings_of` derives them from a table.

    All numbers are rounded to values that float32 can hold, and certified limits are rounded inwards. C in single
    precision therefore makes the same decisions. Raises ArtifactError with every fault.
    """

    scr: Pair
    """The certified box: SCR on the table's basis, R/X, P (W), Q (var) and V (phase rms, V)."""
    r_over_x: Pair
    P: Pair
    Q: Pair
    V_rms: Pair
    R_g: Pair
    """Ranges of plausible estimates in Ω and H."""
    L_g: Pair
    power_range: float
    """Largest \\|P\\| and \\|Q\\| that can be measured, VA."""
    voltage_range: float
    """Largest V that can be measured, V."""
    safe_scr: float
    """The safe place, to which the gains move without estimates (:eq:`safe-place`)."""
    safe_r_over_x: float
    rate: float = 10.0
    """Largest \\|d ln SCR/dt\\| and \\|d ln(R/X)/dt\\| of the place of the gains, 1/s."""
    hysteresis: float = 0.02
    """Relative change of SCR and R/X up to which an estimate does not move the goal."""
    jump: float = 0.5
    """Relative change from which on an estimate must be confirmed."""
    confirm: int = 3
    """Number of windows that must agree on a jump."""
    ratio_floor: float = 0.1
    """Where R/X is smaller than this, its changes are taken relative to this value."""
    tick: float = 1e-6
    """Duration of one tick of the caller's 32-bit counter, s."""
    update_ticks: int = 20_000
    """Nominal number of ticks between two updates."""
    longest_ticks: int = 40_000
    """Longest time, in ticks, for which a single update may move the place."""
    stale_ticks: int = 600_000
    """How long a doubt may last, in ticks, before the place moves to the safe place. This is the time in which an
    estimator finds a new grid after its last surprise."""
    lost_ticks: int = 10_000_000
    """Age of the last good estimate, in ticks, from which on the place moves to the safe place without any doubt."""
    error_R: float = NOT_DESIGNED.error_R
    """The errors of R̂ and X̂ for which the schedule is designed. An estimate whose 95 % set is larger
    is followed in part."""
    error_X: float = NOT_DESIGNED.error_X
    error_Z: float = NOT_DESIGNED.error_Z

    @property
    def error_set(self) -> ErrorSet:
        """The three errors as one."""
        return ErrorSet(self.error_R, self.error_X, self.error_Z)

    @cached_property
    def rate_per_tick(self) -> float:
        """Relative change per tick: the rate rounded down to a multiple of 2^−23, so that 1 + its product with ticks is
        exact in single precision and many steps in a row drift apart by less. Slow rates are left as they are."""
        units = np.floor(self.rate * self.tick * 2.0**23)
        return float(units * 2.0**-23) if units >= 32.0 else float(np.float32(self.rate * self.tick))

    @cached_property
    def limits(self) -> SchedulerLimits:
        """The limits as the equations take them."""
        pairs = {"scr": "scr", "r_over_x": "r_over_x", "P": "P", "Q": "Q", "V_rms": "V", "R_g": "R_g", "L_g": "L_g"}
        values = {
            f"{short}_{end}": getattr(self, name)[at]
            for name, short in pairs.items()
            for at, end in enumerate(("low", "high"))
        }
        others = (name for name in SchedulerLimits._fields if name not in values)
        return SchedulerLimits(**values, **{name: getattr(self, name) for name in others})

    def __post_init__(self) -> None:
        for name in ("scr", "r_over_x", "P", "Q", "V_rms"):
            low, high = getattr(self, name)
            object.__setattr__(self, name, (_single(low, np.inf), _single(high, -np.inf)))
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, float):
                object.__setattr__(self, f.name, _single(value, 0.0) if f.name == "rate" else float(np.float32(value)))
            elif f.name in ("R_g", "L_g"):
                object.__setattr__(self, f.name, tuple(float(np.float32(item)) for item in value))
        faults = list(_faults(self))
        if faults:
            raise ArtifactError("scheduler settings:\n" + "\n".join(f"  - {fault}." for fault in faults))


def settings_of(table: GainTable, **changes: Any) -> SchedulerSettings:
    """The settings that follow from a table. ``changes`` replaces single settings.

    The box is the intersection of the axes, the validity and the certificate of the table. The rate is that of the
    certificate, but at most 10 1/s; it is 10 1/s without a certificate or where the grid may jump. The safe place is
    that of the table, drawn into the box; for a table without one it is that of its structure (:func:`safe_scr`).
    """
    from vsgdesign.artifacts.certificate_record import (
        CertificateRegion,  # only a user with a table needs this room
    )

    # A counterexample has a region, too, but nothing is proved over it.
    certificate = table.certificate
    region = certificate.region if certificate is not None and certificate.certified else CertificateRegion()
    box = {}
    for name, axis in (("scr", table.scr), ("x_over_r", table.x_over_r), ("P", None), ("Q", None), ("V_rms", None)):
        pairs = [getattr(table.validity, name)]
        if axis is not None:
            pairs.append((float(axis[0]), float(axis[-1])))
        if (certified := getattr(region, name, None)) is not None:  # no certificate limits V
            pairs.append(certified)
        box[name] = (max(low for low, _ in pairs), min(high for _, high in pairs))
    x_low, x_high = box.pop("x_over_r")
    r_over_x = 1.0 / x_high, 1.0 / x_low
    own: dict[str, Any] = {"safe_scr": safe_scr(table.structure, box["scr"])}
    if table.safe_place is not None:
        scr, x_over_r = table.safe_place
        own = {"safe_scr": _inside(scr, box["scr"]), "safe_r_over_x": _inside(1.0 / x_over_r, r_over_x)}
    own = own | error_set_of(table)._asdict() | changes
    return box_settings(
        **box,
        r_over_x=r_over_x,
        S_rated=table.base.S_rated,
        V_rated_rms=table.base.V_rated_rms,
        omega=table.base.omega_n,
        scr_basis=table.base.scr_basis,
        error=table.validity.error,
        **({"rate": min(region.rate, 10.0)} if math.isfinite(region.rate) else {}),
        **own,
    )


def safe_scr(structure: str, scr: Pair) -> float:
    """The SCR of the safe place of a structure between limits of SCR where none was searched: their geometric mean
    where the structure is safe in the middle, and otherwise the largest."""
    return math.sqrt(scr[0] * scr[1]) if STRUCTURES[structure].safe_in_the_middle else scr[1]


def lacks_safe_place(table: GainTable) -> bool:
    """Whether a table is from before safe places were searched, so that a new design would add one."""
    return table.safe_place is None and STRUCTURES[table.structure].safe_in_the_middle


def safe_place_text(settings: SchedulerSettings) -> str:
    """The safe place for people to read, as a table's pages and lists show it."""
    return f"SCR {settings.safe_scr:.4g}, X/R {1.0 / settings.safe_r_over_x:.4g}"


def window_settings(period: float, tick: float = SchedulerSettings.tick) -> dict[str, int]:
    """Changes to the settings if estimates come once in each window of ``period`` s and not more often."""
    nominal = SchedulerSettings
    ticks = round(period / tick)
    return {
        "update_ticks": ticks,
        "longest_ticks": max(nominal.longest_ticks, 2 * ticks),
        "stale_ticks": max(nominal.stale_ticks, 4 * ticks),
        "lost_ticks": max(nominal.lost_ticks, 40 * ticks),
    }


def searching_settings(finds_within: float, tick: float = SchedulerSettings.tick) -> dict[str, int]:
    """Changes to the settings if an estimator may be silent for ``finds_within`` s after an event: the schedule holds
    its place for so long."""
    return {"stale_ticks": max(SchedulerSettings.stale_ticks, round(finds_within / tick))}


def box_settings(
    *,
    scr: Pair,
    r_over_x: Pair,
    P: Pair,
    Q: Pair,
    V_rms: Pair,
    S_rated: float,
    V_rated_rms: float,
    omega: float,
    scr_basis: str = "impedance",
    error: float = 0.0,
    **changes: Any,
) -> SchedulerSettings:
    """Settings for a box. The range of plausible estimates extends by ``error`` and a factor of two beyond it.

    The safe place has the largest SCR and the geometric mean of the limits of R/X. ``safe_scr`` gives another SCR, for
    example that of :func:`safe_scr`.
    """
    Z_base = V_rated_rms / rated_current_rms(S_rated, V_rated_rms)
    Z_high = 2.0 * (1.0 + error) * Z_base / scr[0]
    X_high = Z_high
    basis = SCR_BASES[scr_basis]
    R_high = Z_high if basis.counts_resistance else Z_high * max(r_over_x[1], 1.0)
    X_low = 0.5 * (1.0 - min(error, 0.9)) * Z_base / scr[1] / basis.counted(r_over_x[1], 1.0)
    defaults: dict[str, Any] = {
        "R_g": (-0.1 * R_high, R_high),
        "L_g": (X_low / omega, X_high / omega),
        "power_range": 10.0 * S_rated,
        "voltage_range": 3.0 * V_rated_rms,
        "safe_scr": scr[1],
        "safe_r_over_x": float(np.sqrt(r_over_x[0] * r_over_x[1])),
    }
    box = {"scr": scr, "r_over_x": r_over_x, "P": P, "Q": Q, "V_rms": V_rms}
    changed = defaults | changes
    changed["safe_scr"] = min(changed["safe_scr"], _single(scr[1], -np.inf))
    return SchedulerSettings(**box, **changed)


def _inside(value: float, box: Pair) -> float:
    """The value, drawn to between the limits that a box has in single precision."""
    return min(max(value, _single(box[0], np.inf)), _single(box[1], -np.inf))


def _single(value: float, towards: float) -> float:
    """The number nearest to the value, on the given side of it, that float32 holds."""
    rounded = float(np.float32(value))  # a comparison of float32 with a number would round the number, too
    over = rounded < value if towards > value else rounded > value
    return float(np.nextafter(np.float32(rounded), np.float32(towards))) if over else rounded


def _faults(s: SchedulerSettings) -> Iterator[str]:
    for name in ("scr", "r_over_x", "P", "Q", "V_rms", "R_g", "L_g"):
        low, high = getattr(s, name)
        if not (np.isfinite([low, high]).all() and low <= high):
            yield f"{name} = {low:g} {high:g}: the box is empty; make table, validity and certificate overlap"
        elif name in ("scr", "r_over_x", "V_rms", "L_g") and not low > 0.0:
            yield f"{name} = {low:g}: must be positive"
    for name in ("power_range", "voltage_range", "rate", "ratio_floor", "tick"):
        value = getattr(s, name)
        if not (np.isfinite(value) and value > 0.0):
            yield f"{name} = {value:g}: must be positive"
    yield from s.error_set.faults()
    if not 0.0 <= s.hysteresis <= s.jump < 1e3:
        yield f"hysteresis = {s.hysteresis:g}, jump = {s.jump:g}: must be 0 or more, the jump at least the hysteresis"
    if not (s.scr[0] <= s.safe_scr <= s.scr[1] and s.r_over_x[0] <= s.safe_r_over_x <= s.r_over_x[1]):
        yield f"safe_scr = {s.safe_scr:g}, safe_r_over_x = {s.safe_r_over_x:g}: must lie in the box"
    if not 1 <= s.confirm <= 1000:
        yield f"confirm = {s.confirm}: must be 1 to 1000 windows"
    for name in ("update_ticks", "longest_ticks", "stale_ticks", "lost_ticks"):
        value = getattr(s, name)
        if not (isinstance(value, int) and 1 <= value < _TICKS_LIMIT // 2):
            yield f"{name} = {value}: must be a whole number from 1 to 2^30"
    if s.lost_ticks < s.stale_ticks:
        yield f"lost_ticks = {s.lost_ticks}: must be at least stale_ticks = {s.stale_ticks}"
