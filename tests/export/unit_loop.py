"""An exported controller in closed loop with its plant, sample by sample: whatever wrapper it comes in."""

from __future__ import annotations

import ctypes
import functools
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.compilers import require_compiler
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.equations.controller import Measurement
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.export import processor
from vsgdesign.export.compiled import CompiledControl, run_compiler
from vsgdesign.export.port_records import PortList
from vsgdesign.export.processor import LoopRun, Step, phases, vector
from vsgdesign.export.unit import Unit, unit_of
from vsgdesign.export.unit_content import lists_of
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.plant_alone import PlantAlone
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.event import Event

CASES = {0: "hoang2025_5kva", 1: "lab_12kva_lcl"}
"""Without and with a sample of delay."""

STUDY = """
base = "case:{case}"
converter = {{ current_limit_pu = 1.2, current_limiter = "{limiter}" }}
inner_loops = {{ transient_resistance_pu = 0.08 }}
grid = {{ scr_basis = "impedance", scr = 3, x_over_r = 5 }}
power_loops = {{ structure = "angle_damped", tau_P = "5 ms", tau_Q = "5 ms" }}
simulation = {{ duration = "{duration} s", bridge = "averaged", log_interval = "{T_s} s", P_ref = "0.3 pu" }}
controllers = [{{ name = "one", {controller} }}]
"""

FIXED = 'kind = "fixed"'


def study_with(
    delay: int, controller: str = FIXED, duration: float = 0.12, limiter: str = "projection", *, quiet: bool = False
) -> Study:
    """A step of the power, a jump of the grid from SCR 3 to 1.5, and a sag to 30 % for 30 ms; ``quiet``: without."""
    text = f"""base = "case:{CASES[delay]}"
controllers = [{{ name = "one", kind = "fixed" }}]
simulation = {{ duration = "1 s", P_ref = "0 W", Q_ref = "0 var" }}"""
    bare = study_from_text(text)
    S, T_s = bare.converter.S_rated, bare.converter.T_s
    text = STUDY.format(case=CASES[delay], limiter=limiter, duration=duration, T_s=T_s, controller=controller)
    study = study_from_text(text.replace('"0.3 pu"', f'"{0.3 * S} W", Q_ref = "0 var"'))
    if quiet:
        return study
    return study.with_events(
        {"time": "0.01 s", "P_ref": f"{0.6 * S} W"},
        {"time": "0.04 s", "grid": {"scr": 1.5, "x_over_r": 5}},
        {"time": "0.07 s", "V_g_pu": 0.3},
        {"time": "0.1 s", "V_g_pu": 1.0},
    )


def on_a_battery(study: Study) -> Study:
    """On a battery with so little voltage that the bridge is at its limit from the step of the power on."""
    c = study.converter
    needed = rms_to_peak(c.V_rated_rms) * c.V_dc / study.controller_settings().v_max_pk
    battery = {"R_i": 0.1 * needed**2 / c.S_rated, "i_max": 3.0 * c.S_rated / c.V_dc, "capacity_Ah": 0.5}
    battery |= {"open_circuit": [(1.03 + 0.01 * k) * needed for k in range(6)], "charge": 0.5}
    return study.with_changes(dc={"source": "battery", "C": "200 uF", "V_low": 0.1 * c.V_dc, "battery": battery})


def clamping(study: Study) -> Study:
    """On a stage that gives and takes half of the rating, so that the clamp acts from the step of the power on. It
    loses four tenths of this at 90 ms."""
    S = study.converter.S_rated
    stage = {"p_max": 0.5 * S, "p_charge_max": 0.5 * S}
    dc = {"source": "converter", "C": 0.1 * S / 5000.0, "control": "power_clamp", "converter": stage}
    found = study.with_changes(dc=dc)
    return replace(found, events=tuple(sorted((*found.events, Event(0.09, "lost", dc_power=0.6)), key=lambda e: e.t_s)))


def drooping(study: Study) -> Study:
    """On a battery with a drop of 5 %, whose voltage moves the frequency."""
    S, V = study.converter.S_rated, study.converter.V_dc
    battery = {"R_i": 0.05 * V * V / S, "i_max": 3.0 * S / V, "capacity_Ah": S / V}
    dc = {"source": "battery", "C": 0.04 * S / V**2, "control": "voltage_droop", "battery": battery}
    return study.with_changes(dc=dc | {"voltage_droop": {"share": 0.2}})


def run_loop(
    study: Study,
    unit: Unit,
    step: Step,
    *,
    late: int = 0,
    acts_now: bool = False,
    samples: int = 0,
    empty: bool = False,
) -> LoopRun:
    """A wrapper in closed loop with the circuit of a study. ``empty``: the circuit begins without energy."""
    if empty:
        study = replace(study, simulation=replace(study.simulation, start="cold"))
    plant, c = PlantAlone(study, unit.gains), study.converter
    samples = samples or round(study.simulation.duration / c.T_s)
    return processor.run_loop(unit, plant, step, samples, late=late, acts_now=acts_now)


def simulated(study: Study, unit: Unit, feed: FieldScheduler | None = None) -> np.ndarray:
    """The same figures from ``simulate`` with the controller's fixed gains, or with what a feed gives."""
    run = simulate(study, [GainChange(0.0, unit.gains)] if feed is None else feed)
    c = study.converter
    scale = {"P": c.S_rated, "Q": c.S_rated, "omega": c.omega_n, "i_s_alpha": c.I_rated_pk, "i_s_beta": c.I_rated_pk}
    return np.column_stack([run.column(name) / size for name, size in scale.items()])


def plain_c(control: CompiledControl, unit: Unit) -> Step:
    """``vsg_control_step`` itself, at rest where the unit is, with the phases of the wrapper around it."""
    ports = lists_of(unit)["controller"]
    at_in = {port.name: k for k, port in enumerate(ports.inputs)}
    names = [port.name for port in ports.outputs]
    for name, value in unit.rest._asdict().items():
        if isinstance(value, tuple):
            for inner, number in unit.rest.limiter._asdict().items():
                setattr(control.data.state.limiter, inner, number)
        else:
            setattr(control.data.state, name, value)

    def step(given: np.ndarray) -> np.ndarray:
        three = (vector(given[at_in[f"{name}_a"] : at_in[f"{name}_a"] + 3]) for name in ("v", "i_s", "i_g"))
        control.data.refs.P_ref, control.data.refs.Q_ref = given[at_in["P_ref"]], given[at_in["Q_ref"]]
        out = control.step(Measurement(*(part for value in three for part in (value.real, value.imag))))
        told = dict(zip(("v_b_a", "v_b_b", "v_b_c"), phases(complex(out.v_b_alpha, out.v_b_beta)), strict=True))
        told |= {"P": out.P, "Q": out.Q, "omega": out.omega, "limited": out.limited}
        return np.array([told.get(name, math.nan) for name in names])

    return step


def control_of(made: Any, unit: Unit) -> CompiledControl:
    """The compiled controller with the constants of a unit."""
    k = unit.constants
    return made.control(unit.gains, k.inner_gains, unit.grid, unit.references, k.controller_settings)


class Library:
    """The converter with ports of an exported folder, compiled in double precision and called by ctypes."""

    def __init__(self, folder: Path, build: Path, unit: Unit, variant: str = "controller", *flags: str) -> None:
        require_compiler("gcc")
        self.ports: PortList = lists_of(unit)[variant]
        self.word = {"controller": "unit", "reference": "loops"}[variant]
        place = build / f"lib{self.word}.so"
        sources = [str(path) for path in sorted(folder.glob("*.c")) if path.name != "vsg_selftest.c"]
        command = ["gcc", "-std=c99", "-w", "-O0", "-ffp-contract=off", "-shared", "-fPIC", "-DVSG_DOUBLE", *flags]
        run_compiler([*command, *sources, "-o", str(place), "-lm"])
        self._library = ctypes.CDLL(str(place))
        self.parameters = np.array([port.start for port in self.ports.parameters])

    @staticmethod
    def ports_of(unit: Unit, variant: str = "controller") -> PortList:
        """The list of ports of a variant."""
        return lists_of(unit)[variant]

    def instance(self, **parameters: float) -> Instance:
        """One converter, begun with these parameters."""
        return Instance(self, parameters)

    def call(self, name: str, *arguments: Any) -> None:
        """A function of the variant."""
        getattr(self._library, f"vsg_{self.word}_{name}")(*arguments)


class Instance:
    """One converter with ports."""

    def __init__(self, library: Library, parameters: dict[str, float]) -> None:
        self._library = library
        self._struct = ctypes.create_string_buffer(1 << 16)
        self.names = [port.name for port in library.ports.parameters]
        self.parameters = library.parameters.copy()
        for name, value in parameters.items():
            self.parameters[self.names.index(name)] = value
        library.call("begin", self._struct, _doubles(self.parameters))

    def step(self, given: np.ndarray) -> np.ndarray:
        """One sample."""
        outputs = np.zeros(len(self._library.ports.outputs))
        inputs = np.ascontiguousarray(given, dtype=float)
        self._library.call("step", self._struct, _doubles(inputs), _doubles(self.parameters), _doubles(outputs))
        return outputs

    def follow(self, given: np.ndarray) -> None:
        """Begin from what is measured."""
        inputs = np.ascontiguousarray(given, dtype=float)
        self._library.call("follow", self._struct, _doubles(inputs), _doubles(self.parameters))

    def save(self) -> np.ndarray:
        """Every number of the state."""
        numbers = np.full(len(self._library.ports.states), np.nan)
        self._library.call("save", self._struct, _doubles(numbers))
        return numbers

    def load(self, numbers: np.ndarray) -> None:
        """Go on from a state."""
        self._library.call("load", self._struct, _doubles(np.ascontiguousarray(numbers)))


def _doubles(array: np.ndarray) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


@functools.cache
def unit_with(delay: int, controller: str = FIXED, limiter: str = "projection") -> Unit:
    """The unit of :func:`study_with`."""
    return unit_of(study_with(delay, controller, limiter=limiter), ready=NOTHING)
