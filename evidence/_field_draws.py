"""Random runs for the field estimator: a converter, a grid with its background, sensors, and what happens to it.

A run is drawn from its group, its converter and its seed alone. Seeds below 10,000 are for tuning an estimator, seeds
from 100,000 on for evidence. Every draw rests, before and after every change, within the converter's current limit.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from evidence._field_converters import ROOM_PU, Converter, resting_currents
from vsgdesign.simulation.survival.cases import GridState
from vsgdesign.study.parameters.event import Event

EVENT_S = 1.5
"""Earliest instant of the first change, s: the estimator has learned its grid by then."""

AFTER_S = 1.2
"""Length of a run after its last change, s."""

SCR, X_OVER_R = (1.2, 20.0), (0.3, 20.0)
LEAST_CURRENT_PU = 0.1
LEAST_RATIO = 1.5
"""A jump changes \\|Z\\| by at least this factor."""

_ATTEMPTS = 400


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """Background of the grid and errors of the sensors: packaged levels with a seed, and what differs from them.

    Frequency and voltage of the grid are not part of it: they are in the draw's own start.
    """

    background: str = "dirty"
    sensors: str = "dirty"
    seed: int = 0
    noise: float | None = None
    """Standard deviation of a sensor's sample, of rated; None: as the level has it."""
    beat: str = ""
    """Another converter's disturbance: ``modulation`` of the grid's voltage at half its frequency, or a ``line`` at 3/2
    or 5/2 of it. Empty: none."""
    beat_order: float = 0.0
    """Frequency of the beat over that of the grid, its distance from the probe's line included."""
    beat_pu: float = 0.0


@dataclass(frozen=True, kw_only=True)
class FieldDraw:
    """One run."""

    group: str
    converter: str
    seed: int
    start: GridState
    """P_pu and Q_pu are the powers at which it rests; the references follow from the droops."""
    changes: tuple[Event, ...] = ()
    """Times are those of the run. P_pu and Q_pu add to the references."""
    duration_s: float
    surroundings: Surroundings

    @property
    def events_s(self) -> tuple[float, ...]:
        """Instants at which something changes suddenly, the end of a ramp among them."""
        ends = [(one.t_s, one.end_s) for one in self.changes]
        return tuple(sorted({t for pair in ends for t in pair}))

    @property
    def jumps_s(self) -> tuple[float, ...]:
        """Instants at which the grid's impedance changes."""
        return tuple(one.t_s for one in self.changes if one.place is not None)


@dataclass
class _Drawing:
    """What a group changes of the common draw."""

    start: GridState
    changes: tuple[Event, ...] = ()
    surroundings: Surroundings = field(default_factory=Surroundings)
    duration_s: float | None = None


Group = Callable[[np.random.Generator], _Drawing | None]


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(f"{math.exp(rng.uniform(math.log(low), math.log(high))):.5g}")


def uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return round(float(rng.uniform(low, high)), 5)


def _start(rng: np.random.Generator) -> GridState:
    scr, x_over_r = log_uniform(rng, *SCR), log_uniform(rng, *X_OVER_R)
    top = 0.35 if scr < 2.0 else 0.6
    return GridState(
        scr=scr,
        x_over_r=x_over_r,
        P_pu=uniform(rng, -top if rng.random() < 0.3 else 0.1, top),
        Q_pu=uniform(rng, -0.1, 0.2),
        V_g_pu=uniform(rng, 0.9, 1.1),
        df_hz=uniform(rng, -0.5, 0.5),
    )


def _surroundings(rng: np.random.Generator, background: str = "dirty", sensors: str = "dirty") -> Surroundings:
    return Surroundings(background=background, sensors=sensors, seed=int(rng.integers(1 << 31)))


def _measured(group: Group) -> Group:
    """The same in the background that was measured on public mains records, with typical sensors."""

    def drawn(rng: np.random.Generator) -> _Drawing | None:
        drawing = group(rng)
        if drawing is not None:
            V_g_pu, df_hz = uniform(rng, 0.95, 1.05), uniform(rng, -0.05, 0.05)
            drawing.start = replace(drawing.start, V_g_pu=V_g_pu, df_hz=df_hz)
            drawing.surroundings = _surroundings(rng, "measured", "typical")
        return drawing

    return drawn


def _drawing(rng: np.random.Generator) -> _Drawing:
    return _Drawing(_start(rng), surroundings=_surroundings(rng))


def _instant(rng: np.random.Generator) -> float:
    return round(EVENT_S + 0.02 * float(rng.random()), 6)


def _jump(rng: np.random.Generator, start: GridState, t_s: float) -> Event | None:
    """To another grid whose impedance differs by LEAST_RATIO or more."""
    scr = log_uniform(rng, 1.5, SCR[1])
    x_over_r = log_uniform(rng, *X_OVER_R) if rng.random() < 0.5 else start.x_over_r
    ratio = scr / start.scr
    return Event.of_pu(t_s, scr=scr, x_over_r=x_over_r) if max(ratio, 1.0 / ratio) >= LEAST_RATIO else None


def _step_of_source(rng: np.random.Generator, start: GridState) -> dict[str, float]:
    """A step of voltage, phase, frequency, or voltage and phase, as fields of a change."""
    kind = int(rng.integers(4))
    if kind == 0:
        return {"V_g_pu": round(start.V_g_pu + uniform(rng, -0.1, 0.1), 5)}
    if kind == 1:
        return {"phase_deg": uniform(rng, -20.0, 20.0)}
    if kind == 2:
        return {"df_hz": round(start.df_hz + uniform(rng, -0.3, 0.3), 5)}
    return {"V_g_pu": round(start.V_g_pu + uniform(rng, -0.1, 0.1), 5), "phase_deg": uniform(rng, -10.0, 10.0)}


def _resting(duration_s: float, noise: float | None = None) -> Group:
    """Nothing happens."""

    def drawn(rng: np.random.Generator) -> _Drawing:
        drawing = _drawing(rng)
        drawing.duration_s, drawing.surroundings = duration_s, replace(drawing.surroundings, noise=noise)
        return drawing

    return drawn


def _beat(rng: np.random.Generator) -> _Drawing:
    """Another converter's disturbance within 2 Hz of a line of the probe: 0.2 % of modulation or a line of 0.1 %."""
    drawing = _drawing(rng)
    drawing.duration_s = 6.0
    kind = "modulation" if rng.random() < 0.5 else "line"
    line = 0.5 if kind == "modulation" else float(rng.choice([1.5, 2.5]))
    order = round(line + uniform(rng, -2.0, 2.0) / 60.0, 6)  # up to 2 Hz of a 60 Hz grid, 1.7 Hz of 50 Hz
    size = 2e-3 if kind == "modulation" else 1e-3
    drawing.surroundings = replace(drawing.surroundings, beat=kind, beat_order=order, beat_pu=size)
    return drawing


def _jumped(rng: np.random.Generator) -> _Drawing | None:
    drawing = _drawing(rng)
    jump = _jump(rng, drawing.start, _instant(rng))
    drawing.changes = (jump,) if jump else ()
    return drawing if jump else None


def _jump_and_step(rng: np.random.Generator) -> _Drawing | None:
    drawing = _jumped(rng)
    if drawing is not None:
        step = Event.of_pu(0.0, **_step_of_source(rng, drawing.start))
        drawing.changes = (replace(step, t_s=drawing.changes[0].t_s, place=drawing.changes[0].place),)
    return drawing


def _small_jump(rng: np.random.Generator) -> _Drawing | None:
    """|Z| changes by 10 to 50 %, up or down; X/R stays."""
    drawing = _drawing(rng)
    factor = 1.0 + uniform(rng, 0.1, 0.5)
    scr = float(f"{drawing.start.scr * (factor if rng.random() < 0.5 else 1.0 / factor):.5g}")
    drawing.changes = (Event.of_pu(_instant(rng), scr=scr, x_over_r=drawing.start.x_over_r),)
    return drawing if SCR[0] <= scr <= SCR[1] else None


def _no_current(rng: np.random.Generator) -> _Drawing | None:
    drawing = _jumped(rng)
    if drawing is not None:
        drawing.start = replace(drawing.start, P_pu=0.0, Q_pu=0.0)
    return drawing


def _grid_step(rng: np.random.Generator) -> _Drawing:
    """The source alone: steps, a ramp of the frequency, a sag."""
    drawing, t_s = _drawing(rng), _instant(rng)
    start, kind = drawing.start, rng.random()
    if kind < 0.6:
        drawing.changes = (Event.of_pu(t_s, **_step_of_source(rng, start)),)
    elif kind < 0.8:
        rate = uniform(rng, 0.5, 2.0) * (1.0 if rng.random() < 0.5 else -1.0)
        drawing.changes = (Event.of_pu(t_s, df_hz=round(start.df_hz + 0.5 * rate, 5), over_s=0.5),)
    else:
        length = uniform(rng, 0.05, 0.3)
        sag = Event.of_pu(t_s, V_g_pu=round(start.V_g_pu * uniform(rng, 0.5, 0.9), 5))
        drawing.changes = (sag, Event.of_pu(round(t_s + length, 6), V_g_pu=start.V_g_pu))
    return drawing


def _power_step(rng: np.random.Generator) -> _Drawing:
    drawing = _drawing(rng)
    step = Event.of_pu(_instant(rng), P_pu=uniform(rng, -0.3, 0.3), Q_pu=uniform(rng, -0.1, 0.1))
    drawing.changes = (step,)
    return drawing


GROUPS: dict[str, Group] = {
    "rest": _resting(4.0),
    "jump": _jumped,
    "jump and step": _jump_and_step,
    "small jump": _small_jump,
    "jump at no current": _no_current,
    "grid-side step": _grid_step,
    "power step": _power_step,
    "measured: rest": _measured(_resting(8.0)),
    "measured: jump": _measured(_jumped),
    "beat": _beat,
    "noise 1 %": _resting(4.0, noise=0.01),
    "long rest": _resting(60.0),
}
"""Every group by name."""


def field_draw(converter: Converter, group: str, seed: int) -> FieldDraw:
    """The run of a seed: the first of its draws that the converter can rest in, before and after every change."""
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([zlib.crc32(f"{converter.name}, {group}".encode()), seed, attempt])
        drawing = GROUPS[group](rng)
        if drawing is None:
            continue
        last = max((one.end_s for one in drawing.changes), default=0.0)
        draw = FieldDraw(
            group=group,
            converter=converter.name,
            seed=seed,
            start=drawing.start,
            changes=drawing.changes,
            duration_s=drawing.duration_s or round(last + AFTER_S, 6),
            surroundings=drawing.surroundings,
        )
        currents = resting_currents(converter, draw.start, draw.changes)
        if currents is None or max(currents) > ROOM_PU:
            continue
        if group in ("jump", "jump and step", "measured: jump") and min(currents) < LEAST_CURRENT_PU:
            continue
        return draw
    raise ValueError(f"{converter.name}, {group}, seed {seed}: no draw in {_ATTEMPTS} attempts rests within the limit.")
