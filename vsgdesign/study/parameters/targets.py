"""The section [power_loops]: what the closed-form gains aim at, the gains themselves, and the power filters."""

from __future__ import annotations

from dataclasses import field, replace

from vsgdesign.equations.placing import PLACED, Poles, paced, placed_poles, placing_time
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import PUBLISHED, STRUCTURES
from vsgdesign.study.parameters.fields import S_RATED, Scope, fields_of, number, picked, section, values, word
from vsgdesign.study.parameters.reader import TableReader

POWER_FILTERS = ("low_pass", "notch")
"""How P and Q are filtered before the power loops."""

NOTCH_DAMPING = 0.5
"""Damping ratio of the notch's poles where a study says nothing."""

_MOST = 2.0 * S_RATED


@section
class ClosedFormTarget:
    """The targets of the closed-form gains, and the operating point at which the Jacobian is taken."""

    settling_time: float = number("s", 0.01, 1000.0, default=1.0)
    """T_set in ω_n = 4/(ξ T_set). At ξ = 1 the loop takes 1.46 times as long (:eq:`critical-settling`)."""
    damping_ratio: float = number("1", 0.05, 20.0, default=1.0)
    """ξ of the P loop."""
    droop_ratio: float = number("1", 0.0, 10.0, default=0.01)
    """q in D_q = q·D."""
    P: float = number("W", -1.0 * _MOST, _MOST, default=0.9 * S_RATED, name="P_design")
    """Active power of the operating point at which A and D are taken."""
    Q: float = number("var", -1.0 * _MOST, _MOST, default=0.2 * S_RATED, name="Q_design")
    """Reactive power of this operating point."""
    structure: str = word(lambda: tuple(STRUCTURES), default=PUBLISHED.name)
    """Control law."""
    k_1: float = number("1/s²", 1e-3, 1e6, default=PLACED.k_1, shown=f"scaled: {PLACED.k_1:.4g}/T_d²")
    """Pole placement of δ: s² + d_1 s + k_1, for T_d (:eq:`placed-poles`)."""
    d_1: float = number("1/s", 1e-3, 1e4, default=PLACED.d_1, shown=f"scaled: {PLACED.d_1:.4g}/T_d")
    """Pole placement of δ: s² + d_1 s + k_1."""
    k_2: float = number("1/s", 1e-3, 1e4, default=PLACED.k_2, shown=f"scaled: {PLACED.k_2:.4g}/T_d")
    """Pole placement of V: s + k_2."""
    P_droop: float = number("1", 0.0, 1.0, default=0.05)
    """Frequency deviation, pu, that rated power answers; 0: none. `decoupled` has the droop that its damping needs."""
    Q_droop: float = number("1", 0.0, 1.0, default=0.05)
    """Voltage deviation, pu, that rated power answers; 0: none."""
    share_P: float = number("1", 0.0, 1.0, default=1.0)
    """Share of the coupling B taken out of the P row."""
    share_Q: float = number("1", 0.0, 1.0, default=1.0)
    """Share of the coupling C taken out of the Q row."""
    follow_references: bool = word(
        ("design", "reference"),
        default="design",
        shown="`design` for `published`, else `reference`",
        name="operating_point",
        true="reference",
    )
    """Where a closed form takes the Jacobian: at `P_design`, `Q_design`, or at the measured P, Q and V, which follow
    the references. A table always takes the measured ones."""
    given: tuple[str, ...] = field(default=(), compare=False)
    """The poles that the study gives. The others are placed, with the next two."""
    mean_s: float = 0.0
    """Time of the mean with which steps are judged, s."""
    margin: float = 0.0
    """Share m of the time that the placing leaves."""

    @property
    def placing_time(self) -> float:
        """T_d in s (:eq:`placed-poles`)."""
        return placing_time(self.settling_time, self.mean_s, self.margin)

    def placed(self, mean_s: float, margin: float) -> ClosedFormTarget:
        """With the poles that the study does not give placed for this mean and this margin (:eq:`placed-poles`)."""
        to_place = replace(self, mean_s=mean_s, margin=margin)
        poles, fast_V = placed_poles(to_place.placing_time)._asdict(), STRUCTURES[self.structure].fast_V
        if fast_V is not None:
            poles["k_2"] = fast_V / self.settling_time
        return replace(to_place, **{name: value for name, value in poles.items() if name not in self.given})


class Filters:
    """How the measured powers are filtered."""

    tau_P: float = number("s", 0.0, 1.0, default=0.0)
    """Time constant of the filter on P; 0: none."""
    tau_Q: float = number("s", 0.0, 1.0, default=0.0)
    """Time constant of the filter on Q; 0: none."""
    power_filter: str = word(POWER_FILTERS, default="low_pass")
    """`notch`: before these filters, a notch at twice the nominal frequency in P and Q takes away what a negative
    sequence makes of them ([why](theory/power-filters.md))."""
    notch_damping: float = number("1", 0.05, 2.0, default=NOTCH_DAMPING)
    """Damping ratio of the notch's poles; only with `notch`."""


_STRUCTURE = picked(ClosedFormTarget, "structure")
_TARGET = tuple(one for one in fields_of(ClosedFormTarget) if one not in _STRUCTURE)

TARGETS = (*_STRUCTURE, *_TARGET)
POWER_LOOPS = (*fields_of(Filters), *TARGETS)
"""The fields of [power_loops]."""

_CROSS = (-1e6, 1e6)


class Gains:
    """The fields of [controllers.gains]."""

    K_ip: float = number("rad/(s²·W)", 1e-15, 1e6)
    """Integral gain of the P loop."""
    D_p: float = number("W·s/rad", 0.0, 1e12)
    """P–ω droop and damping."""
    K_iq: float = number("V/(s·var)", 1e-15, 1e6)
    """Integral gain of the Q loop, V phase rms."""
    D_q: float = number("var/V", 0.0, 1e12)
    """Q–V droop, V phase rms."""
    K_pq: float = number("rad/(s²·var)", *_CROSS, default=0.0)
    """Integral gain from Q to the frequency, which cancels the coupling."""
    K_qp: float = number("V/(s·W)", *_CROSS, default=0.0)
    """Integral gain from P to the voltage, which cancels the coupling."""
    k_P: float = number("rad/(s·W)", *_CROSS, default=0.0)
    """Damping of P through the angle."""
    k_Q: float = number("rad/(s·var)", *_CROSS, default=0.0)
    """Damping of Q through the angle."""


def read_power_gains(table: TableReader) -> PowerLoopGains:
    """The gains of a controller that gives them all."""
    gains = PowerLoopGains(**values(Gains, table))
    table.finish()
    return gains


def read_target(table: TableReader, scope: Scope, default: ClosedFormTarget | None = None) -> ClosedFormTarget:
    """The target of a table; what it does not give is that of ``default``, else that of the fields."""
    defaults = (
        {} if default is None else {one.name: getattr(default, one.attribute) for one in fields_of(ClosedFormTarget)}
    )
    before = default or ClosedFormTarget(P=0.0, Q=0.0)
    structure = values(_STRUCTURE, table, scope, defaults)["structure"]
    settling_time = values(_TARGET[:1], table, scope, defaults)["settling_time"]
    k_1, d_1, k_2 = paced(before.k_1, before.d_1, before.k_2, before.settling_time / settling_time)
    defaults |= {"k_1": k_1, "d_1": d_1, "k_2": k_2, "operating_point": _operating_point(before, structure)}
    rest = values(_TARGET[1:], table, scope, defaults)
    given = tuple(name for name in Poles._fields if name in before.given or table.has(name))
    return ClosedFormTarget(structure=structure, settling_time=settling_time, given=given, **rest)


def _operating_point(default: ClosedFormTarget, structure: str) -> str:
    """As the default target has it, or as another structure has it by itself."""
    same = structure == default.structure or structure not in STRUCTURES  # the reader has told of an unknown name
    follows = default.follow_references if same else STRUCTURES[structure].follows_references
    return "reference" if follows else "design"
