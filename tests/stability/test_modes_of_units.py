"""Modes of plants: the whole model against the two models of one unit, and the model against its own map.

The common model here is the full-order model of one converter on x_t + N Z_g, which knows nothing of plants.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from tests.simulation.test_plants import GAINS, NETWORK, T_S, plant_of, plant_study
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.circuit_of_units import grid_of_unit
from vsgdesign.linear.operating_point.flow_of_units import clock_of
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.linear.operating_point.rest_of_units import PlantMap, UnitsAtRest, rest_of_units
from vsgdesign.linear.stability.modes_of_units import NETWORK as OF_NETWORK
from vsgdesign.linear.stability.modes_of_units import modes_of_units, split_matrices, split_modes
from vsgdesign.metrics.modes import to_continuous
from vsgdesign.simulation.units import plant_timeline
from vsgdesign.simulation.units.start import situation_at
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.power_plant import behind_its_path

STEEP = PowerLoopGains(K_ip=0.00767, D_p=2087.0, K_iq=0.115, D_q=0.687)
"""Right for one converter on a weak grid, too high for x_t alone."""


def rest_of(study: Study, gains: PowerLoopGains = GAINS) -> UnitsAtRest:
    """The plant at rest at its start."""
    timeline = plant_timeline(study)
    count = len(timeline.units)
    return rest_of_units(situation_at(study, timeline, timeline.segments[0], [gains] * count, range(count)))


def equal_units(count: int, more: str = "") -> Study:
    """N converters behind 6 % at one node."""
    return plant_study(f"[plant]\nunits = {count}\nreactance = 0.06\nresistance = 0.01\n{more}")


@pytest.mark.parametrize("count", [2, 4, 8])
def test_the_spectrum_of_equal_units_is_that_of_two_models(count: int) -> None:
    study = equal_units(count)
    rest = rest_of(study, STEEP)
    whole = to_continuous(np.linalg.eigvals(rest.A), T_S)
    unit = plant_of(study).units[0]
    grid = grid_of_unit(study, unit, rest.model.situation.topology)
    alone = linearise_full_order(
        replace(behind_its_path(study, unit), plant=None), [Cell(grid, STEEP, unit.P_ref, unit.Q_ref)]
    )
    common = to_continuous(np.linalg.eigvals(alone.A[0]), T_S)
    (names, C), (_, D) = split_matrices(rest)
    differential = to_continuous(np.linalg.eigvals(D), T_S)
    for modes, times in ((common, 1), (differential, count - 1)):
        for s in modes[modes.real > -500.0]:
            nearest = np.sort(np.abs(whole - s))[:times]
            assert nearest.max() < 1e-5
    assert len(whole) == len(common) + (count - 1) * len(differential)
    assert common.real.max() < 0.0 < differential.real.max()  # what one converter keeps, several do not

    own = [name for name, kept in zip(rest.model.names, rest.model.kept, strict=True) if kept]
    order = [own.index(f"unit{k + 1}.{name.partition('.')[2]}") for k in range(count) for name in names]
    seed = np.random.default_rng(count).normal(size=(count, count - 1))
    mean = np.linalg.qr(np.column_stack([np.ones(count), seed]))[0]
    turn = np.kron(mean, np.eye(len(names)))
    A = rest.A[np.ix_(order, order)]
    assert np.abs(turn.T @ A @ turn - block_diag(C, *[D] * (count - 1))).max() < 1e-9 * np.abs(A).max()


def test_the_modes_are_named_and_split() -> None:
    rest = rest_of(equal_units(3), STEEP)
    found, split = modes_of_units(rest, 4), split_modes(rest, 4)
    assert split is not None
    assert found[0].s.real == pytest.approx(split.differential[0].s.real, abs=1e-6)
    assert sum(share for _, share in found[0].units) == pytest.approx(1.0, abs=0.01)


def test_unequal_units_have_no_split() -> None:
    rest = rest_of(plant_study(NETWORK))
    assert split_modes(rest) is None
    slowest = modes_of_units(rest, 12)
    assert {name for one in slowest for name, _ in one.units} <= {"near", "second", OF_NETWORK}


def test_the_model_is_the_derivative_of_the_map() -> None:
    """Two units with offsets on a cable: central differences along random directions."""
    rest = rest_of(plant_study(NETWORK))
    model: PlantMap = rest.model
    rng = np.random.default_rng(3)
    size = np.abs(rest.z) + 1e-3
    for _ in range(4):
        step = np.where(model.kept, rng.normal(size=len(rest.z)) * size * 1e-6, 0.0)
        ahead, back = (model(rest.z + sign * step, derivative=False)[0] for sign in (1.0, -1.0))
        expected = (0.5 * (ahead - back))[model.kept]
        assert np.abs(rest.A @ step[model.kept] - expected).max() < 1e-6 * np.abs(expected).max()


def test_a_unit_of_another_case_and_clock() -> None:
    """A unit that samples with 16 kHz beside one with 20 kHz: the instants repeat after 250 µs."""
    study = equal_units(2)
    plant = plant_of(study)
    slow = replace(study, converter=replace(study.converter, f_sw=8000.0), plant=None)
    units = (plant.units[0], replace(plant.units[1], case=slow))
    rest = rest_of(replace(study, plant=replace(plant, units=units)))
    assert rest.model.clock.period == pytest.approx(250e-6, rel=1e-12)
    assert [one.units for one in rest.model.clock.instants] == [(0, 1), (0,), (1,), (0,), (1,), (0,), (1,), (0,)]
    assert modes_of_units(rest, 1)[0].s.real < 0.0


def test_clocks_that_never_meet_are_refused() -> None:
    with pytest.raises(InfeasibleStudyError, match=r"network: .*one 20000 Hz, other 19999 Hz.* do not repeat"):
        clock_of(["one", "other"], [50e-6, 1.0 / 19999.0], [0.0, 0.0])
