"""Small specifications on the published system, for tests of the optimizer."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.design.box import Scenarios, scenarios_of_estimate
from vsgdesign.design.evaluation import LawOfStudy, law_of
from vsgdesign.design.search import variables
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.specification import Specification
from vsgdesign.study.parameters.study import ControllerSpec

ROOT = Path(__file__).resolve().parents[2]

TEXT = """
base = "studies/structures/study.toml"
study = { name = "robust", title = "robust" }
[power_loops]
Q_droop = 0.5
[specification]
scr_basis = "impedance"
settling_time = "1.3 s"
overshoot = 0.05
disk_margin = 1.0
P = [-4500, 4500]
Q = [-2000, 2000]
error = 0.2
scr = [3, 6]
x_over_r = [1, 3]
"""

SETTLING = 1.3


@functools.cache
def robust_study(text: str = TEXT) -> Study:
    return study_from_text(text, folder=ROOT)


def with_specification(**changes: Any) -> Study:
    """The study with other fields of its specification; those of the box too."""
    study = robust_study()
    spec = specification(study)
    box = {name: changes.pop(name) for name in list(changes) if hasattr(spec.box, name)}
    return replace(study, specification=replace(spec, box=replace(spec.box, **box), **changes))


def specification(study: Study) -> Specification:
    assert study.specification is not None
    return study.specification


def controller(study: Study, name: str = "angle_damped") -> ControllerSpec:
    return next(spec for spec in study.controllers if spec.name == name)


def law(study: Study, name: str = "angle_damped") -> LawOfStudy:
    return law_of(study, controller(study, name).target, specification(study).aim)


def scenarios(study: Study, scr: float, x_over_r: float) -> Scenarios:
    target = controller(study).target
    return scenarios_of_estimate(study, specification(study), scr, x_over_r, target.P, target.Q)


def textbook(study: Study, name: str = "angle_damped") -> np.ndarray:
    """y of the closed form at the specified settling time: a centre to design around."""
    T = specification(study).settling_time
    v = variables(law(study, name).structure, specification(study))
    return v.of(NormalisedGains(15.8 / T**2, 6.6 / T, 4.0 / T, 0.01, 1.0, 1.0))
