"""The compiled loop of a run with its numbers: from the state before a sample to the state after it, many times.

The body of the loop is one straight line (:mod:`vsgdesign.simulation.bodies`). It is compiled without contraction and
without approximation, so that it gives the same bits on every processor, and so does plain Python: an interval that an
event cuts into pieces is run by Python, operation by operation.
"""

from __future__ import annotations

import functools
import typing
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import Loop, LoopSpec, best_lanes, compiled_loop
from vsgdesign.equations.controller import ControllerSettings, ControllerState
from vsgdesign.equations.field import FieldSettings
from vsgdesign.equations.grid import FilterGrid
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import GridEstimate
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.simulation.axes import FALLING, PEAK, RISING, Axes
from vsgdesign.simulation.bodies import (
    WAVE_ROW,
    bodies,
    held,
    moves,
    pcc_names,
    piece_names,
    products,
    row_names,
    seek_names,
    wave_names,
)
from vsgdesign.simulation.circuit_sample import CarrierPart, carrier
from vsgdesign.simulation.dc_parts import dc_kind_of
from vsgdesign.simulation.run_kind import DISTURBANCE, SYNC, Bridge, Kind, names_of
from vsgdesign.simulation.sample import Noise, RampRow, Sensors
from vsgdesign.simulation.watched_sample import LoadDemand
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

LOG_COLUMNS = (
    "i_s_alpha",
    "i_s_beta",
    "v_c_alpha",
    "v_c_beta",
    "i_g_alpha",
    "i_g_beta",
    "v_g_alpha",
    "v_g_beta",
    "P",
    "Q",
    "omega",
    "V_rms",
    "theta",
    "limited_samples",
    "at_bridge",
)
"""What a run keeps of a sample, SI and peak. Voltages and currents are those of the circuit; P and Q are what the
controller measures with its sensors, before its filters. ``limited_samples`` counts the samples from the start of the
run up to and including this one in which the current limiter acted. ``at_bridge`` is 1 where the bridge's voltage is at
its limit in this sample, else 0."""

SEEN_COLUMNS = ("i_s_alpha", "i_s_beta", "P", "Q", "V_rms", "theta", "limited_samples")
"""What is kept of every sample where a log has fewer rows: what the judge of survival looks at."""

SENSED_COLUMNS = ("measured.v_alpha", "measured.v_beta", "measured.i_g_alpha", "measured.i_g_beta")
"""What is kept besides where the sensors are not ideal: what they say of the capacitor node's voltage and of i_g."""


class Build(NamedTuple):
    """How a loop is compiled: for so many runs at once, for which processor, and whether every operation rounds by
    itself."""

    lanes: int = 1
    vectors: int = 1
    strict: bool = True
    target: str = "native"
    quickly: bool = False
    """For short runs (:func:`vsgdesign.codegen.llvm.compiled_loop`)."""


ALONE = Build()
"""A run alone, with the bits of plain Python."""


def side_by_side(*, strict: bool, target: str = "native") -> Build:
    """Runs side by side: as many as a register holds, two of them at once. One computes while the other waits, and more
    of them do not fit into the registers."""
    return Build(best_lanes(target), 2, strict, target)


def kind_of(study: Study, *, switched: bool, axes: Axes | None = None) -> Kind:
    """The kind of a study's runs without anything that only some of them have."""
    c, f, limiter = study.converter, study.filter, study.limiter
    memory, constants = (typing.get_type_hints(made)["return"] for made in (limiter.at_rest, limiter.build))
    slopes = slopes_of(c.samples_per_carrier) if switched else ()
    bridge = Bridge(slopes, zero_sequence=bool(c.zero_sequence), delayed=c.delay_samples > 0)
    dc = dc_kind_of(study, switched=switched, networks=axes is not None)
    return Kind(limiter.law, memory, constants, bridge, axes, second_inductor=f.L_2 + f.R_2 > 0.0, dc=dc)


class KindLoop(NamedTuple):
    """The compiled loop of a kind of run, and the place of every number in it."""

    kind: Kind
    loop: Loop
    spec: LoopSpec
    place: dict[str, int]
    """Row of every number of the state and of every constant."""
    spans: Mapping[str, slice]
    """Rows of every record among them, which are beside each other, and of every number."""


SHARED_DEMAND = ("of.band", "of.per_S", "of.per_cycle", "load_of.limit_sq")
"""What is demanded of all runs of a loop alike."""


@functools.cache
def loop_of(kind: Kind, logged: tuple[str, ...] = (), build: Build = ALONE) -> KindLoop:
    """The compiled loop of a kind of run."""
    spec = spec_of(kind, logged, build)
    place = {name: row for row, name in enumerate(spec.rows)}
    return KindLoop(kind, compiled_loop(spec, build.target, build.quickly), spec, place, spans_of(spec.rows))


@functools.cache
def spec_of(kind: Kind, logged: tuple[str, ...] = (), build: Build = ALONE) -> LoopSpec:
    """Where the numbers of a kind of run stand. Rows and uniform numbers are the same whatever is added or logged.

    A field estimator that is alone ends the loop with its cycle, and an instant that is found where it is found.
    """
    moved, rings = moves(kind, watched_names(kind)), () if kind.cut else kind.rings
    slot = "slot" if kind.waits and logged else ""
    stop = "closed" if kind.field and not kind.waits else ""
    if kind.seeks and not kind.cut:
        stop = "ends" if stop else "found"
    still = moved if kind.seeks else tuple(pair for pair in (*moved, *rings) if pair[0] != "k")
    moved = held(moved, kind)
    state = {name for name, _ in moved}
    wanted = [*(output for _, output in (*moved, *rings)), *(name for name in (stop, slot) if name)]
    wanted += [name for name in logged if name not in state]
    made = bodies(kind, tuple(dict.fromkeys(wanted)), still if kind.waits or kind.seeks else ())
    known = {name for block in made for name in block.inputs}
    known |= {name for product in products(kind) for name in product.matrix}
    return LoopSpec(
        bodies=made,
        state=moved,
        constant=tuple(name for name in _constant_names(kind) if name in known),
        uniform=tuple(name for name in _uniform_names(kind) if name in known),
        cyclic=() if kind.cut else tuple(name for name in names_of(CarrierPart, "part") if name in known),
        fed=fed_names(kind),
        rings=rings,
        products=products(kind),
        logged=logged,
        slot=slot,
        index="k" if "k" in known and not kind.waits else "",
        stop=stop,
        lanes=build.lanes,
        vectors=build.vectors,
        strict=build.strict,
    )


def watched_names(kind: Kind) -> tuple[str, ...]:
    """The numbers of what is watched."""
    if kind.watched is None:
        return ()
    unwatched: tuple[str, ...] = ("watch.late",)
    if kind.own_rest:
        of_mean = "watch.most", "watch.entry.", "watch.sum", "watch.mean"
        unwatched = ("watch.entry.",) if kind.watch == DISTURBANCE else of_mean
    return tuple(name for name in names_of(kind.watched[0], "watch") if not name.startswith(unwatched))


def fed_names(kind: Kind) -> tuple[str, ...]:
    """What is given for every sample: what the source's other components add, the noise of the sensors, and where an
    angle is watched against a source that is moved by what is fed, by how much it turns."""
    fed = [*(f"more.{name}" for name in kind.states), "added.alpha", "added.beta"] if kind.added else []
    fed += names_of(Noise, "noise") if kind.sensors else []
    return (*fed, *(("extra",) if kind.moved and kind.watch == DISTURBANCE else ()))


def log_names(kind: Kind, states_logged: bool = False) -> tuple[str, ...]:
    """What the log of a run has: LOG_COLUMNS, SENSED_COLUMNS where the sensors are not ideal, the circuit's other
    states, and the controller's own where they are ``states_logged``."""
    commanded = {"state.theta": "commanded_theta", "state.V": "commanded_V"} if kind.field else {}
    if SYNC in kind.seeks:
        commanded = {name: name.replace("state.", "chosen.", 1) for name in kind.names(ControllerState, "state")}
    logged = [f"x.{name}" for name in kind.states[:6]]
    omega = "turned_omega" if kind.dc is not None and kind.dc.droops else "said.omega"
    logged += ["v_g_alpha", "v_g_beta", "said.P", "said.Q", omega]
    logged += [commanded.get(name, name) for name in ("state.V", "state.theta")]
    logged += ["limited_samples", "at_bridge", *(SENSED_COLUMNS if kind.sensors else ())]
    logged += [f"x.{name}" for name in kind.states[6:]]
    logged += kind.dc.logged if kind.dc is not None else []
    own = kind.names(ControllerState, "state") if states_logged else []
    return (*logged, *(commanded.get(name, name) for name in own))


def _constant_names(kind: Kind) -> list[str]:
    """Inputs that every run has for itself and no sample moves."""
    found = [*row_names(kind), "V_g"]
    found += [name for wave in wave_names(kind) for name in (*(f"{wave}.row.{one}" for one in WAVE_ROW), f"{wave}.V")]
    found += names_of(RampRow, "ramp_of") if kind.ramped else []
    found += kind.dc.settings if kind.dc is not None else []
    found += [*names_of(References, "refs"), *names_of(PowerLoopGains, "power_gains"), *names_of(GridEstimate, "grid")]
    found += [*(names_of(Sensors, "sensors") if kind.sensors else []), *seek_names(kind)]
    found += ["circuit.R_g", "circuit.L_g"] if kind.taken else []
    if kind.watched is not None:
        found += [*names_of(kind.watched[1], "of"), *names_of(LoadDemand, "load_of"), "circuit.R_g", "circuit.L_g"]
        found += pcc_names(kind)
    if kind.cut:
        pieces = [piece_names(kind, number) for number in range(1, len(kind.cut))]
        found += [*names_of(CarrierPart, "part"), *(name for names in pieces for name in names.values())]
        found += [name for name, _ in kind.rings]
    return [name for name in found if name not in SHARED_DEMAND]


def _uniform_names(kind: Kind) -> list[str]:
    """Inputs that are the same for all runs of a loop."""
    found = [*names_of(InnerLoopGains, "inner_gains"), *kind.names(ControllerSettings, "settings"), "R_c", "V_dc"]
    found += [*SHARED_DEMAND, *(f"circuit.{name}" for name in FilterGrid._fields if name not in ("R_g", "L_g"))]
    found += ["log_begin"] if kind.waits else []
    return found + ([*names_of(FieldSettings, "field"), "V_rated_rms", "allowed"] if kind.field else [])


@functools.lru_cache(maxsize=256)
def spans_of(names: tuple[str, ...]) -> Mapping[str, slice]:
    """Where the numbers of every record stand, and of every record within one."""
    found: dict[str, slice] = {}
    for row, name in enumerate(names):
        parts = name.split(".")
        for length in range(1, len(parts) + 1):
            record = ".".join(parts[:length])
            found[record] = slice(found[record].start if record in found else row, row + 1)
    return MappingProxyType(found)


def carrier_part(begin: Any, end: Any) -> CarrierPart:
    """An interval on the carrier; numbers or arrays."""
    return CarrierPart(begin, end, carrier(begin))


def slopes_of(samples_per_carrier: int) -> tuple[str, ...]:
    """Where the samples of a carrier's period lie on it."""
    n = samples_per_carrier
    return tuple(RISING if 2 * (j + 1) <= n else FALLING if 2 * j >= n else PEAK for j in range(n))


def carrier_values(slopes: tuple[str, ...]) -> tuple[Array, NDArray[np.int64]]:
    """What depends on the place on the carrier: (n, 3) of :class:`CarrierPart`, and the number of the body (n)."""
    n, kinds = len(slopes), list(dict.fromkeys(slopes))
    begin = np.arange(n) / max(n, 1)
    return np.column_stack(carrier_part(begin, begin + 1.0 / max(n, 1))), np.array(
        [kinds.index(slope) for slope in slopes], dtype=np.int64
    )
