"""The loop of a run: an interval that Python runs has its bits, and a leg switches where the carrier meets it."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from tests.codegen.plain_blocks import Plain
from tests.simulation.studies import GAINS, lc_study, lcl_study
from tests.simulation.test_emt_against_dop853 import SENSORS, compare
from tests.simulation.test_field_in_the_loop import FOLLOWING
from vsgdesign.equations.controller_data import Nothing
from vsgdesign.equations.limiters import CIRCULAR
from vsgdesign.linear.operating_point.plant import plant_step, state_matrices, two_axes
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.simulation.axes import FALLING, PEAK, RISING, Axes, states_of
from vsgdesign.simulation.bodies import plant
from vsgdesign.simulation.circuit_sample import BridgeVoltage, carrier, modulation
from vsgdesign.simulation.circuits import Circuits
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.loop import ALONE, carrier_part, log_names, loop_of, slopes_of
from vsgdesign.simulation.run_kind import LARGEST_DEGREE, Bridge, Kind
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study import parameters
from vsgdesign.study.parameters import Grid, Study, study_from_text
from vsgdesign.study.parameters.study import Event


@pytest.mark.parametrize(
    ("build", "bridge", "more"),
    [
        (lc_study, "averaged", ""),
        (lcl_study, "averaged", SENSORS),
        (lcl_study, "pwm", SENSORS),
        (lc_study, "pwm", FOLLOWING),
        (lcl_study, "pwm", "two axes"),
    ],
)
def test_an_interval_in_pieces_leads_where_the_whole_one_does(
    build: Callable[..., Study], bridge: str, more: str
) -> None:
    """An event within an interval, at which nothing changes, changes no more than rounding does."""
    study = build("6 ms", "" if more == "two axes" else more, simulation='start = "cold"')
    circuit = (lambda grid: two_axes(study.circuit(grid))) if more == "two axes" else None
    again = Event(t_s=1.0123e-3, name="the same again", grid=study.grid)

    def run(study: Study) -> np.ndarray:
        given = FieldScheduler(study, study.controllers[-1]) if more == FOLLOWING else [GainChange(0.0, GAINS)]
        found = simulate(study, given, bridge=bridge, log_states=60, circuit=circuit)
        return np.concatenate([found.log[:60], found.controller_log], axis=1)

    whole, in_pieces = run(study), run(replace(study, events=(again,)))
    size = np.abs(whole).max(axis=0)
    assert np.all(np.abs(in_pieces - whole) <= 1e-12 * size)
    assert not np.array_equal(in_pieces, whole)


def test_a_jump_at_the_sample_after_an_interval_in_pieces() -> None:
    """Before: the interval that ends with a jump of the phase lost the event within it."""
    events = '[[events]]\ntime = "1.0123 ms"\ngrid = { scr = 4 }\n[[events]]\ntime = "1.05 ms"\nphase_jump = "20 deg"\n'
    compare(lc_study("4 ms", events), [GainChange(0.0, GAINS)], "averaged")


# Where a leg switches.

CASES = sorted(path.stem for path in Path(parameters.__file__).with_name("cases").glob("*.toml"))

H, N = 100e-6, {RISING: 2, FALLING: 2, PEAK: 1}
PLACES = {RISING: (0.0, 0.5), FALLING: (0.5, 1.0), PEAK: (0.0, 1.0)}


def moved(slope: str, applied: BridgeVoltage, V_dc: float, axes: bool) -> np.ndarray:
    """The circuit after an interval from rest, without a source."""
    circuit = lc_study("1 ms").circuit()
    h = H / N[slope]
    step = plant_step(two_axes(circuit) if axes else circuit, h, 314.0)
    run = Kind(
        CIRCULAR.law, Nothing, Nothing, Bridge((slope,), True, False), Axes(6, len(step.edge) - 1) if axes else None
    )
    part = carrier_part(*PLACES[slope])
    values = {f"part.{name}": value for name, value in part._asdict().items()}
    values |= {f"x.{name}": 0.0 for name in states_of(None)} | {"source.cosine": 0.0, "source.sine": 0.0, "V_dc": V_dc}
    values |= {"said.v_b_alpha": applied.alpha, "said.v_b_beta": applied.beta, "row.turn_cos": 1.0, "row.turn_sin": 0.0}
    if axes:
        for name, table in (("p", step.transition), ("b", step.bridge), ("s", step.source[0])):
            values |= {f"row.{name}_{i}_{k}": float(table[i, k]) for i in range(6) for k in range(table.shape[1])}
        degree = range(len(step.edge))
        values |= {f"edge.c{d}_{i}_{k}": float(step.edge[d, i, k]) for d in degree for i in range(6) for k in range(2)}
    else:
        values |= {f"row.p{i + 1}{k + 1}": float(step.transition[i, k]) for i in range(3) for k in range(3)}
        values |= {f"row.b{i + 1}": float(step.bridge[i]) for i in range(3)}
        values |= {f"row.{part}{i + 1}": 0.0 for part in ("re", "im") for i in range(3)}
        padded = np.zeros((LARGEST_DEGREE + 1, 3))
        padded[: len(step.edge)] = step.edge
        names = ("i_s", "v_c", "i_g")
        values |= {f"edge.{name}.c{d}": float(padded[d, i]) for i, name in enumerate(names) for d in range(len(padded))}
    found = Plain(plant(run, slope))(values)
    return np.array([found[f"moved.{name}"] for name in states_of(None)])


def expected(slope: str, applied: BridgeVoltage, V_dc: float) -> np.ndarray:
    """By matrix exponentials between the instants at which a leg meets the carrier, found by its definition."""
    A, b, _ = state_matrices(lc_study("1 ms").circuit())
    begin, end = PLACES[slope]
    m = modulation(applied.alpha, applied.beta, V_dc, True)
    instants = sorted({begin, end, 0.5} | {p for one in m for p in ((one + 1.0) / 4.0, (3.0 - one) / 4.0)})
    instants = [p for p in instants if begin <= p <= end]
    x: Any = np.zeros(3, dtype=complex)
    turn = np.exp(2j * np.pi * np.arange(3) / 3.0)
    for one, other in itertools.pairwise(instants):
        if other - one < 1e-12:
            continue
        high = np.array([1.0 if value > carrier(0.5 * (one + other)) else -1.0 for value in m])
        v = 2.0 / 3.0 * turn @ (0.5 * V_dc * high)
        M = np.zeros((4, 4))
        M[:3, :3], M[:3, 3] = A, b
        step = expm(M * (other - one) * H)
        x = step[:3, :3] @ x + step[:3, 3] * v
    return np.stack([x.real, x.imag], axis=1).ravel()


@pytest.mark.parametrize("axes", [False, True])
@pytest.mark.parametrize("slope", [RISING, FALLING, PEAK])
def test_a_leg_switches_where_the_carrier_meets_it(slope: str, axes: bool) -> None:
    """At random voltages, beyond the linear limit among them, and where a leg begins or ends on the carrier: no
    voltage, and a leg at its valley or its peak."""
    rng = np.random.default_rng(4)
    V_dc = 400.0
    edge = BridgeVoltage(V_dc / 3.0**0.5, 0.0)
    voltages = [
        BridgeVoltage(*(r * np.array([np.cos(a), np.sin(a)])).tolist()) for r, a in rng.uniform(0, 340, (25, 2))
    ]
    for applied in [
        BridgeVoltage(0.0, 0.0),
        edge,
        BridgeVoltage(-edge.alpha, 0.0),
        BridgeVoltage(0.0, 200.0),
        *voltages,
    ]:
        found, true = moved(slope, applied, V_dc, axes), expected(slope, applied, V_dc)
        np.testing.assert_allclose(found, true, rtol=0.0, atol=2e-12 * np.abs(true).max() + 1e-11)


def test_samples_lie_on_the_carrier() -> None:
    assert slopes_of(1) == (PEAK,)
    assert slopes_of(2) == (RISING, FALLING)
    assert slopes_of(3) == (RISING, PEAK, FALLING)
    assert slopes_of(4) == (RISING, RISING, FALLING, FALLING)


@pytest.mark.parametrize("case", CASES)
def test_the_loops_polynomials_suffice_for_every_packaged_converter(case: str) -> None:
    """From SCR 1 to 25. Without its economy the series of half of them had a degree of 16 to 19."""
    text = f'base = "case:{case}"\n[inner_loops]\nK_pv = 0.05\nK_iv = 20\nK_pc = 10\nK_ic = 2000\n'
    text += '[grid]\nscr = 1\nx_over_r = 2\n[simulation]\nduration = "1 s"\nP_ref = "0 W"\nQ_ref = "0 var"\n'
    study = study_from_text(text + '[[controllers]]\nname = "a"\nkind = "scheduled"\n')
    for scr in (1.0, 25.0):
        grid = Grid(study.grid.R_g / scr, study.grid.L_g / scr)
        step = plant_step(study.circuit(grid), study.converter.T_s, study.converter.omega_n)
        assert len(step.edge) <= LARGEST_DEGREE + 1


def test_a_stiff_circuit_against_an_ode_solver() -> None:
    """Its edge polynomial has a degree for which nothing is written out: it goes the way of two axes."""
    study = lcl_study("6 ms", '[[events]]\ntime = "1.0123 ms"\nphase_jump = "8 deg"\n', R_c='"60 ohm"')
    circuits = Circuits(study, [build_timeline(study)], switched=True)
    assert circuits.axes is not None
    assert circuits.axes.degree > LARGEST_DEGREE
    compare(study, [GainChange(0.0, GAINS)], "pwm")


def test_every_instruction_set_gives_the_same_bits() -> None:
    """What is strict has no rounding of its own on any processor."""
    study, found = lc_study("4 ms"), []
    for target in ("native", "avx2", "sse2"):
        with pytest.MonkeyPatch.context() as patch:
            try:
                kind = Kind(CIRCULAR.law, Nothing, Nothing, Bridge())
                loop = loop_of(kind, log_names(kind), ALONE._replace(target=target))
            except ValueError:  # this processor has it not
                continue
            patch.setattr("vsgdesign.simulation.loop.loop_of", lambda *_, own=loop: own)
            found.append(simulate(study, [GainChange(0.0, GAINS)], bridge="averaged").log.tobytes())
    assert len(found) >= 1
    assert len(set(found)) == 1
