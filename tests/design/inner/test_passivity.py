"""The band in which a converter is passive, against modes with drawn networks; and the worst capacitance."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vsgdesign.design.inner import GridBox, PassiveBand, passive_band
from vsgdesign.design.inner.grids import angle_damped_target, asked_of, study_of
from vsgdesign.design.inner.passivity import _oscillation, _power_gains
from vsgdesign.linear.operating_point.circuit_of_units import Topology
from vsgdesign.linear.operating_point.flow_of_units import UnitAsked, situation_of
from vsgdesign.linear.operating_point.rest_of_units import rest_of_units
from vsgdesign.metrics.modes import to_continuous
from vsgdesign.report.stability.inner import passivity_sentences
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.power_plant import Element, PowerPlant, Unit, cable_elements

STUDIES = Path(__file__).resolve().parents[3] / "studies" / "survival"


@functools.cache
def loaded(name: str) -> Study:
    return load_study(STUDIES / f"{name}.toml")


@functools.cache
def band(name: str) -> PassiveBand:
    own = loaded(name)
    asked = asked_of(own)
    box = GridBox(asked.scr, asked.x_over_r, asked.scr_basis)
    return passive_band(own.converter, own.filter, own.inner_gains, own.omega_t, box, settling_time=asked.settling_time)


@pytest.mark.parametrize(("name", "begins", "ends"), [("laboratory", 14.4, 7000.0), ("study", 52.4, 7000.0)])
def test_the_band_of_the_page(name: str, begins: float, ends: float) -> None:
    found = band(name)
    assert found.from_hz == pytest.approx(begins, rel=0.01)
    assert found.to_hz == pytest.approx(ends, rel=1e-12)
    assert found.cells >= 8


def test_no_drawn_network_oscillates_within_the_band() -> None:
    """Cables, shunts with R, L and C, and transformers at random: no mode within the band grows."""
    own, rng = loaded("laboratory"), np.random.default_rng(30)
    box = GridBox((1.2, 20.0))
    target = angle_damped_target(1.0, own.converter.omega_n)
    study = study_of(own.converter, own.filter, own.inner_gains, own.omega_t, box, target=target)
    c, found = study.converter, band("laboratory")
    assert found.from_hz is not None
    for _ in range(8):
        scr, ratio = float(np.exp(rng.uniform(0.5, 2.7))), float(np.exp(rng.uniform(0.0, 2.7)))
        grid = Place(scr, ratio, "impedance").grid(c)
        L, C = c.Z_base / c.omega_n, 1.0 / (c.Z_base * c.omega_n)
        a, b, d, e = np.exp(rng.uniform(-6.0, -2.0, 4))
        elements = (
            *cable_elements("cable", "pcc", "far", 0.2 * a * c.Z_base, a * L, b * C),
            Element("trap", "trap", "far", "", 0.1 * d * c.Z_base, d * L, e * C),
        )
        unit = Unit(name="unit", node="far", P_ref=0.5 * c.S_rated, Q_ref=0.0)
        plant = PowerPlant(nodes=("pcc", "far"), elements=elements, sources=(), units=(unit,), pcc="pcc")
        gains = _power_gains(study, grid, 0.5 * c.S_rated)
        assert gains is not None
        asked = UnitAsked(study, gains, c.references(0.5 * c.S_rated, 0.0), grid)
        topology = Topology(grid, frozenset())
        rest = rest_of_units(situation_of(replace(study, plant=plant), topology, (asked,), c.omega_n, c.V_rated_rms))
        s = to_continuous(np.linalg.eigvals(rest.A), c.T_s)
        hertz = np.abs(s.imag) / (2.0 * math.pi)
        inside = s[(hertz > found.from_hz) & (hertz < found.to_hz)]
        assert len(inside) > 6  # some of them are the network's
        assert inside.real.max() < 0.0


def test_an_LC_filter_is_warned_of() -> None:
    """A capacitance of 0.004 pu behind 0.005 pu makes the published converter oscillate, behind 0.06 pu hardly any."""
    found = band("study")
    assert found.warns
    assert found.worst is not None
    assert found.worst.real > 50.0
    assert found.worst.series_pu < 0.02
    own = loaded("study")
    c, target = own.converter, angle_damped_target(1.0, own.converter.omega_n)
    grows = []
    for series in (0.005, 0.06):
        f = replace(own.filter, L_2=series * c.Z_base / c.omega_n)
        study = study_of(c, f, own.inner_gains, own.omega_t, GridBox((1.2, 20.0)), target=target)
        grid = Place(5.0, 3.0, "impedance").grid(c)
        gains = _power_gains(study, grid, 0.5 * c.S_rated)
        assert gains is not None
        s = _oscillation(study, grid, gains, 0.004)
        assert s is not None
        grows.append(s.real)
    assert grows[0] > 10.0
    assert grows[1] < 0.0
    assert not band("laboratory").warns


def test_the_sentences() -> None:
    document = vars(band("study")) | {"worst": vars(band("study").worst), "warns": True}
    lines = " ".join(passivity_sentences(document))
    assert "Between 52.44 Hz and 7 kHz in the frame of the source, the output admittance is passive at all 8" in lines
    assert "This is a scan and no proof." in lines
    assert "grows with" in lines
    assert "of 0.02 pu or more between them" in lines
    none = passivity_sentences(document | {"from_hz": None, "worst": None, "warns": False})
    assert "is not passive at every operating point" in none[0]
    assert len(none) == 2
