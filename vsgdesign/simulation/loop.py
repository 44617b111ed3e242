"""The compiled loop of a run with its numbers: from the state before a sample to the state after it, many times.

The body of the loop is one straight line (:mod:`vsgdesign.simulation.bodies`). It is compiled without contraction and
without approximation, so that it gives the same bits on every processor, and so does plain Python: an interval that an
event cuts into pieces is run by Python, operation by operation.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.blocks import Plain
from vsgdesign.codegen.llvm import Loop, LoopSpec, StandingLoop, compiled_loop
from vsgdesign.codegen.records import Kinds
from vsgdesign.equations.controller import ControllerSettings, ControllerState, Measurement
from vsgdesign.equations.controller_data import flat_state
from vsgdesign.equations.field import FieldSettings, LockIn
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import GridEstimate
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.simulation.bodies import FALLING, PEAK, RISING, Axes, Run, bodies, control, plant, states_of
from vsgdesign.simulation.lanes.sample import CarrierPart, EdgeRow, PlantRow, carrier
from vsgdesign.simulation.records import numbers_of
from vsgdesign.simulation.sample import Noise, Sensors

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
)
"""What a run keeps of a sample, SI and peak. Voltages and currents are those of the circuit; P and Q are what the
controller measures with its sensors, before its filters. ``limited_samples`` counts the samples from the start of the
run up to and including this one in which the current limiter acted."""

SENSED_COLUMNS = ("measured.v_alpha", "measured.v_beta", "measured.i_g_alpha", "measured.i_g_beta")
"""What is kept besides where the sensors are not ideal: what they say of the capacitor node's voltage and of i_g."""


class PieceRows(NamedTuple):
    """A part of a sampling interval: the numbers of its circuit, the source's phasor at its beginning, its place on the
    carrier (none: averaged), and what the source's other components add to the states over it (none: nothing)."""

    circuit: Mapping[str, Array]
    source: tuple[float, float]
    slope: str = ""
    part: CarrierPart | None = None
    more: Array | None = None


class Layout(NamedTuple):
    """Names of a loop's numbers."""

    state: tuple[tuple[str, str], ...]
    constant: tuple[str, ...]
    uniform: tuple[str, ...]
    fed: tuple[str, ...]
    logged: tuple[str, ...]

    @property
    def rows(self) -> tuple[str, ...]:
        """Of the rows: the state, then the constants."""
        return (*(name for name, _ in self.state), *self.constant)


@functools.cache
def layout_of(run: Run, states_logged: bool = False) -> Layout:
    """Where the numbers of a run's loop stand. Rows and uniform numbers are the same whatever is added or logged."""
    names, switched = states_of(run.axes), bool(run.bridge.slopes)
    kinds = Kinds({ControllerState: {"limiter": run.memory}, ControllerSettings: {"limiter": run.constants}})

    def of(head: str, kind: type) -> list[str]:
        return [f"{head}.{path}" for path in kinds.paths(kind)]

    own = of("state", ControllerState)
    after = {"state.theta": "next_theta", "state.V": "next_V"} if run.field else {"state.theta": "kept_angle"}
    told = {"state.theta": "commanded_theta", "state.V": "commanded_V"} if run.field else {}
    moved = "arrived" if run.added else "moved"
    state = [(f"x.{name}", f"{moved}.{name}") for name in names]
    state += [(name, after.get(name, name.replace("state.", "following.", 1))) for name in own]
    state += [("limited", "limited_samples"), *((f"source.{part}", f"turned.{part}") for part in ("cosine", "sine"))]
    if run.bridge.delayed:
        state += [(f"pending.{axis}", f"said.v_b_{axis}") for axis in ("alpha", "beta")]
    if run.sensors:
        state += [(f"before.{path}", f"true.{path}") for path in Measurement._fields]
    if run.field:
        state += [(name, name.replace("lock.", "heard.", 1)) for name in of("lock", LockIn)]
    if run.axes is None:
        constant = of("row", PlantRow) + (of("edge", EdgeRow) if switched else [])
    else:
        constant = _two_axis_names(run.axes, switched)
    constant += ["V_g", *of("refs", References), *of("power_gains", PowerLoopGains), *of("grid", GridEstimate)]
    uniform = [*of("inner_gains", InnerLoopGains), *of("settings", ControllerSettings), "R_c"]
    if switched:
        uniform.append("V_dc")
    if run.sensors:
        uniform += of("sensors", Sensors)
    if run.field:
        uniform += [*of("field", FieldSettings), "V_rated_rms", "allowed"]
    fed = [f"more.{name}" for name in names] + ["added.alpha", "added.beta"] if run.added else []
    fed += of("noise", Noise) if run.sensors else []
    logged = [f"x.{name}" for name in names[:6]]
    logged += ["v_g_alpha", "v_g_beta", "said.P", "said.Q", "said.omega"]
    logged += [told.get("state.V", "state.V"), told.get("state.theta", "state.theta"), "limited_samples"]
    logged += SENSED_COLUMNS if run.sensors else ()
    logged += [f"x.{name}" for name in names[6:]]
    logged += [told.get(name, name) for name in own] if states_logged else []
    return Layout(tuple(state), tuple(constant), tuple(uniform), tuple(fed), tuple(logged))


def _two_axis_names(axes: Axes, switched: bool) -> list[str]:
    rows = range(axes.states)
    pairs = [(row, axis) for row in rows for axis in axes.on(row)]
    found = [f"row.p_{row}_{k}" for row in rows for k in rows if k % 2 in axes.on(row)]
    found += [f"row.b_{row}_{axis}" for row, axis in pairs]
    found += [f"row.s_{row}_{axis}" for row in rows for axis in range(2)]
    found += ["row.turn_cos", "row.turn_sin"]
    if switched:
        found += [f"edge.c{k}_{row}_{axis}" for k in range(axes.degree + 1) for row, axis in pairs]
    return found


@functools.cache
def loop_of(run: Run, states_logged: bool = False, quickly: bool = False) -> Loop:
    """The compiled loop, which logs the controller's states or not. ``quickly``: for short runs (``compiled_loop``)."""
    layout = layout_of(run, states_logged)
    stop = "closed" if run.field else ""
    wanted = dict.fromkeys([*(output for _, output in layout.state), *([stop] if stop else [])])
    inputs = set(layout.rows)
    wanted |= dict.fromkeys(name for name in layout.logged if name not in inputs)
    blocks = bodies(run, tuple(wanted))
    known = {name for block in blocks for name in block.inputs}
    return compiled_loop(
        LoopSpec(
            bodies=blocks,
            state=layout.state,
            constant=layout.constant,
            uniform=layout.uniform,
            cyclic=tuple(f"part.{name}" for name in CarrierPart._fields if f"part.{name}" in known),
            fed=layout.fed,
            logged=layout.logged,
            stop=stop,
            strict=True,
        ),
        quickly=quickly,
    )


@functools.cache
def _plain_control(run: Run) -> Plain:
    return Plain(control(run))


@functools.cache
def _plain_plant(run: Run, slope: str) -> Plain:
    return Plain(plant(run, slope))


def carrier_part(begin: float, end: float) -> CarrierPart:
    """An interval on the carrier."""
    return CarrierPart(begin, end, float(carrier(begin)))


def slopes_of(samples_per_carrier: int) -> tuple[str, ...]:
    """Where the samples of a carrier's period lie on it."""
    n = samples_per_carrier
    return tuple(RISING if 2 * (j + 1) <= n else FALLING if 2 * j >= n else PEAK for j in range(n))


class RunLoop:
    """The numbers of one run, and the compiled loops that move them.

    A number is found by its name, those of a record by the record's: ``put("refs", refs)``. ``quickly``: the run is
    short, so that compiling takes longer than running.
    """

    def __init__(self, run: Run, quickly: bool = False) -> None:
        self.run, self._quickly = run, quickly
        layout = layout_of(run)
        self._circuit: Mapping[str, Array] | None = None
        self._names = layout.rows
        self._rows = np.zeros((1, len(layout.rows), 1))
        self._uniform = np.zeros(len(layout.uniform))
        self._uniform_names = layout.uniform
        self._loops: dict[tuple[bool, bool], tuple[Array, StandingLoop]] = {}
        self._places = _heads(layout.rows)
        self._uniform_places = _heads(layout.uniform)
        slopes = run.bridge.slopes
        kinds = list(dict.fromkeys(slopes))
        n = len(slopes)
        self._cycle = np.array([kinds.index(slope) for slope in slopes], np.int64)
        self._parts = [carrier_part(j / n, j / n + 1.0 / n) for j in range(n)]
        self._cyclic = np.array(self._parts, float).reshape(n, len(CarrierPart._fields))

    def view(self, head: str) -> Array:
        """The numbers of a record as an array that moves with the run."""
        return self._rows[0, self._places[head], 0]

    def put_piece(self, piece: PieceRows) -> None:
        """Sets the circuit and the source."""
        if piece.circuit is not self._circuit:
            self._circuit = piece.circuit
            for head, values in piece.circuit.items():
                self.put(head, values)
        self.put("source", piece.source)

    def put(self, head: str, record: Any) -> None:
        """Sets a number or the numbers of a record."""
        values = record
        if head == "state":
            values = flat_state(record)
        elif head in ("settings", "sensors"):
            values = numbers_of(record)
        if head in self._places:
            self._rows[0, self._places[head], 0] = values
        else:
            self._uniform[self._uniform_places[head]] = values

    def state(self, like: ControllerState) -> ControllerState:
        """The controller's state."""
        numbers = self.view("state").tolist()
        count = len(like) - 1
        return ControllerState(*numbers[:count], limiter=type(like.limiter)(*numbers[count:]))

    def advance(self, begin: int, end: int, log: Array, every: int, fed: Array | None, states: bool = False) -> int:
        """Runs samples ``begin`` to ``end`` − 1, or fewer where a field estimator's cycle ends before. Returns
        how many.

        ``log``: a row for every ``every``-th sample of the run. ``fed`` (samples, n): what is given sample by sample;
        None where nothing is added to the source and the sensors are ideal. ``states``: whether the log has the
        controller's states.
        """
        added = fed is not None and fed.shape[1] > (len(Noise._fields) if self.run.sensors else 0)
        loop = self._standing(added, states, log, every)
        return loop(begin, end, None if fed is None else fed[None, : end - begin, :, None])

    def _standing(self, added: bool, states: bool, log: Array, every: int) -> StandingLoop:
        """The loop over this run's numbers. A run has one log for each kind of loop."""
        key = added, states
        if key not in self._loops or self._loops[key][0] is not log:
            loop = loop_of(self.run._replace(added=added), states, self._quickly)
            several = len(loop.spec.bodies) > 1
            self._loops[key] = (
                log,
                loop.standing(
                    self._rows,
                    self._uniform,
                    cyclic=self._cyclic if loop.spec.cyclic else None,
                    cycle=self._cycle if several else None,
                    log=log[None, :, :, None],
                    every=every,
                ),
            )
        return self._loops[key][1]

    def advance_in_pieces(self, pieces: list[PieceRows], log: Array, fed: Array, states: bool = False) -> None:
        """Runs one sample whose interval is in pieces, in plain Python. ``log`` is the row to write, ``fed`` (n) what
        the loop would be given."""
        run = self.run._replace(added=True)
        layout = layout_of(run, states)
        self.put_piece(pieces[0])
        here = dict(zip(self._names, self._rows[0, :, 0].tolist(), strict=True))
        here |= dict(zip(self._uniform_names, self._uniform.tolist(), strict=True))
        here |= dict(zip(layout.fed, fed.tolist(), strict=True))
        here |= _plain_control(run)(here)
        log[:] = [here[name] for name in layout.logged]
        following = dict(here)
        for piece in pieces:
            for head, values in piece.circuit.items():
                following |= dict(zip(self._names[self._places[head]], values.tolist(), strict=True))
            following |= dict(zip(self._names[self._places["source"]], piece.source, strict=True))
            if piece.part is not None:
                following |= {f"part.{name}": value for name, value in piece.part._asdict().items()}
            if piece.more is not None:
                following |= dict(zip(layout.fed, piece.more.tolist(), strict=False))
            arrived = _plain_plant(run, piece.slope)(following)
            following |= arrived
            following |= {f"x.{name}": arrived[f"arrived.{name}"] for name in states_of(run.axes)}
        self._rows[0, : len(layout.state), 0] = [following[output] for _, output in layout.state]


def _heads(names: tuple[str, ...]) -> dict[str, slice]:
    """Where the numbers of every record stand."""
    found: dict[str, slice] = {}
    for at, name in enumerate(names):
        head = name.partition(".")[0]
        found[head] = slice(found[head].start if head in found else at, at + 1)
    return found
