"""What the list of an exported controller's ports is made of, and the records that wrappers alone have."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any, NamedTuple

from vsgdesign.equations.notation import Count

VARIANTS = ("controller", "reference")
"""The whole controller, whose output is the bridge voltage, and its power loops alone, whose output is a voltage."""

INPUT, OUTPUT, FIXED, TUNABLE = "input", "output", "fixed", "tunable"
"""What a port is: an input, an output, a parameter that is read at the start, or one that may change at any time."""


class Asked(NamedTuple):
    """What a wrapper asks besides the measured values."""

    closed: Any = 1.0
    """1 while the breaker between the converter and the grid is closed, else 0."""
    estimated: Any = 1.0
    """1 while R_g and L_g are an estimate that may be followed, else 0."""
    delta: Any = 0.0
    """Angle of the measured voltage against a frame that turns at the nominal frequency from the start on, rad."""
    scheduling: Any = 1.0
    """1: the gains follow the estimate; 0: they stay as they are."""
    probe: Any = 1.0
    """1: the field estimator sends its probe; 0: it does not."""
    i_max_pk: Any = 0.0
    """Current limit, A peak."""
    start: Any = 0.0
    """0: the controller begins at rest at the operating point; 1: it follows the measured voltage until it is ready."""
    P_start: Any = 0.0
    """Active power at which it begins at rest, W."""
    Q_start: Any = 0.0
    """Reactive power at which it begins at rest, var."""
    V_start: Any = 0.0
    """Voltage of the power loops at which it begins at rest, V phase rms."""
    theta_start: Any = 0.0
    """Angle at which it begins at rest, rad."""
    v_dc: Any = 0.0
    """Measured voltage of the dc link, V."""
    P_dc_low: Any = 0.0
    """Power that the source of the dc link can give now at least; negative: what it can take, W."""
    P_dc_high: Any = 0.0
    """Power that the source of the dc link can give now at most, W."""
    units: Any = 1.0
    """Units of the plant that are on line, itself included, a whole number. Each sees so many times the impedance of
    the node; with any other number the estimate is not followed."""
    pair: Any = 1.0
    """Pair of lines on which the field estimator sends its probe, 1 to 4. Those on one grid take different ones."""


class Told(NamedTuple):
    """What a wrapper tells besides the controller's own output."""

    used: Any
    """1 if the sample was used; 0 if it was left out, because a number in it was no number or beyond every limit."""
    ready: Any
    """1 if the breaker may close, or is closed; 0 while the controller follows the measured voltage and is not in step
    with it yet."""
    reason: Any
    """Number of the reason why the last estimate was not followed; 0 if it was."""
    delta: Any
    """Angle of the converter's voltage against a frame that turns at the nominal frequency from the start on, rad."""
    P_cut: Any
    """By how much P_ref is changed to what the source of the dc link can give, W."""


class UnitMemory(NamedTuple):
    """What a wrapper remembers besides the controller and its scheduler."""

    steps: Count
    """Samples since the start."""
    following: Count
    """1 while it follows the measured voltage, else 0."""
    seeded: Count
    """1 if it has seen the voltage that it follows, else 0."""
    apart: Count
    """1 if the breaker was open in the last sample, else 0."""
    in_step: Count
    """Samples in which the breaker might have closed, without one between them in which it might not."""
    limited: Count
    """Samples since the last update of the gains in which the current limiter acted."""
    status: Count
    """Bits of the scheduler's last answer."""
    reason: Count
    """Reason of the scheduler's last answer."""
    frame: Any
    """Angle of the frame that turns at the nominal frequency, rad."""
    v_dc: Any
    """Last voltage of the dc link that could be one, V."""
    pair: Count
    """Pair of lines of the probe."""
    P_ref: Any
    """Last active power that was asked for, W."""
    P_dc_low: Any
    """Last power that the source could give at least, W."""
    P_dc_high: Any
    """Last power that the source could give at most, W."""
    omega: Any
    """Frequency by which the P-f droop is limited, behind its low-pass, rad/s."""
    omega_lost: Any
    """What rounding left out of this frequency, rad/s."""


STATUS_MEANINGS = {
    "fresh": "1 if the scheduler followed the last estimate, else 0",
    "held": "1 if the scheduler did not follow the last estimate, else 0: see the reason",
    "clamped": "1 if P, Q, V or the estimated grid is outside the box of the schedule, else 0",
    "limited": "1 if the place of the gains is still on its way to the estimate, else 0",
    "fallback": "1 if the scheduler was too long in doubt or without an estimate, and its place moves to the safe one",
    "refused": "1 if what the scheduler was given could not be used, else 0",
    "doubt": "1 if the grid may have changed since the last estimate that was followed, else 0",
    "partly": "1 if the estimate is less certain than the design allows, and is followed in part, else 0",
}


@dataclass(frozen=True)
class Port:
    """One number that goes into an exported controller or comes out of it."""

    name: str
    unit: str
    """As the records write it; 1 for a number without a unit."""
    meaning: str
    kind: str
    """INPUT, OUTPUT, FIXED or TUNABLE."""
    start: float
    """With which it begins; of an output, its value at rest."""
    low: float = -math.inf
    high: float = math.inf
    whole: bool = False
    """Whether nothing but whole numbers makes sense."""


@dataclass(frozen=True)
class Stored:
    """One number of a controller's state."""

    name: str
    """Where it is in the struct of C."""
    unit: str
    meaning: str
    whole: bool
    bits: int = 0
    """Of a whole number; 0 for a real one."""


@dataclass(frozen=True)
class PortList:
    """Everything that a wrapper is printed from."""

    variant: str
    ports: tuple[Port, ...]
    states: tuple[Stored, ...]

    def of(self, *kinds: str) -> list[Port]:
        """The ports of some kinds, in order."""
        return [port for port in self.ports if port.kind in kinds]

    @property
    def inputs(self) -> list[Port]:
        """What is read in every sample."""
        return self.of(INPUT)

    @property
    def outputs(self) -> list[Port]:
        """What is written in every sample."""
        return self.of(OUTPUT)

    @property
    def parameters(self) -> list[Port]:
        """Fixed and tunable parameters."""
        return self.of(FIXED, TUNABLE)

    def document(self) -> dict[str, Any]:
        """The list in JSON's types; a limit that is not there is None."""

        def limit(value: float) -> float | None:
            return value if math.isfinite(value) else None

        return {
            "variant": self.variant,
            "ports": [
                {
                    "name": one.name,
                    "kind": one.kind,
                    "unit": one.unit,
                    "meaning": one.meaning,
                    "start": one.start,
                    "low": limit(one.low),
                    "high": limit(one.high),
                }
                | ({"whole": True} if one.whole else {})
                for one in self.ports
            ],
            "states": [{"name": one.name, "unit": one.unit, "meaning": one.meaning} for one in self.states],
        }


def plain_unit(unit: str) -> str:
    """A unit alone, in ASCII: without what it is a value of. Empty for none."""
    bare = re.sub(r" (phase rms|rms|peak|\(rms\))$", "", unit)
    return "" if bare == "1" else bare.replace("Ω", "Ohm").replace("·", ".").replace("²", "2")


def refusal(port: Port) -> str:
    """Why a value outside the limits of a parameter is refused, in ASCII."""
    if port.whole:
        return f"{port.name}: no whole number from {port.low:g} to {port.high:g}."
    return f"{port.name}: outside {port.low!r} to {port.high!r} {plain_unit(port.unit)}".rstrip() + "."
