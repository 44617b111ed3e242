"""A network behind the field estimator, in the EMT and in plain Python: it speaks behind its gate, and only there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.artifacts.field_networks import random_field_weights
from tests.simulation.studies import lc_study
from vsgdesign.artifacts.field_weights import FIELD_WEIGHTS_FILE, FieldWeights
from vsgdesign.equations.field import FieldAnswer, FieldFeatures
from vsgdesign.equations.field.fusion import FIRST_GATE, LONG_AGO
from vsgdesign.errors import ArtifactError, StudyError
from vsgdesign.identification.field import field_network
from vsgdesign.identification.interface import Installation, build_estimator
from vsgdesign.simulation import simulate
from vsgdesign.simulation.field_feed import FieldScheduler, settings_of_study
from vsgdesign.study.parameters import Study

FOLLOWING = """
[[controllers]]
name = "field"
kind = "scheduled"
estimate = "{estimate}"
[estimator]
field_weights = "{weights}"
"""
JUMP = """
[[events]]
time = "0.4 s"
grid = { scr = 3 }
"""


def doubling(confident: float = 0.15) -> FieldWeights:
    """A network that always answers twice the impedance, with a deviation of 0.25 %, from cycle 2 after an event."""
    weights = random_field_weights(FieldFeatures._fields)
    layers = weights.layers
    said = np.array([np.log(2.0), 0.0, -6.0, -6.0, 0.0])
    spoken = replace(layers, W_3=np.zeros_like(layers.W_3), b_3=said)
    return replace(weights, layers=spoken, gate=weights.gate._replace(first=2.0, confident=confident))


def answers(folder: Path, weights: FieldWeights, estimate: str = "field_network") -> tuple[Study, list[FieldAnswer]]:
    """Answers of a run with a jump of the grid."""
    FIELD_WEIGHTS_FILE.write(weights, folder / "w.json")
    study = lc_study("0.7 s", JUMP + FOLLOWING.format(estimate=estimate, weights=folder / "w.json"))
    feed = FieldScheduler(study, study.controllers[-1])
    simulate(study, feed, bridge="averaged")
    return study, [row.answer for row in feed.rows]


def test_it_speaks_in_its_gate_alone(tmp_path: Path) -> None:
    _, alone = answers(tmp_path, doubling(), "field")
    _, silent = answers(tmp_path, doubling(confident=1e-6))
    assert silent == alone
    _, found = answers(tmp_path, doubling())
    flag = next(k for k, answer in enumerate(alone) if answer.event > 0.5)
    # Before the flag, and up to the gate, nothing is changed. The run is the same until the first answer that differs.
    first = next(k for k, (one, other) in enumerate(zip(alone, found, strict=True)) if one != other)
    assert first - flag == 2
    assert alone[first].valid == 0.0
    assert found[first].R_g == pytest.approx(2.0 * alone[first].R_g, rel=1e-9)
    assert found[first].L_g == pytest.approx(2.0 * alone[first].L_g, rel=1e-9)
    assert (found[first].valid, found[first].changed) == (1.0, 1.0)
    assert found[first].doubt == alone[first].doubt


def test_plain_python_and_the_run_agree() -> None:
    """The same features and answers through the same functions, with floats in and out."""
    weights = doubling()
    network = field_network(weights, FieldFeatures._fields)
    study = lc_study("50 ms", FOLLOWING.format(estimate="field", weights="none"))
    settings = settings_of_study(study)
    c = study.converter
    at = Installation(T_s=c.T_s, omega_n=c.omega_n, V_base=1.0, Z_base=1.0, samples=1, sample_interval=c.T_s)
    built = build_estimator("field_network", replace(at, weights=weights))
    assert built.first().gate == FIRST_GATE
    seen = FieldFeatures(*np.zeros(len(FieldFeatures._fields)).tolist())
    answer = FieldAnswer(
        **(dict.fromkeys(FieldAnswer._fields, 0.0) | {"R_g": 1.0, "L_g": 2e-3, "mode": 2.0, "passive": 1.0})
    )
    gate, said = network.behind(FIRST_GATE, seen, answer, settings)
    assert (gate.since, said) == (LONG_AGO, answer)
    gate, said = network.behind(gate, seen, answer._replace(event=1.0), settings)
    assert (gate.since, said.valid) == (0.0, 0.0)
    for _ in range(2):
        gate, said = network.behind(gate, seen, answer, settings)
    assert (gate, said.valid) == ((2.0, 1.0), 1.0)
    assert all(type(value) is float for value in (*gate, *said))


def test_weights_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match=r"other features \(they lack .*current.*; they also take size\)"):
        answers(tmp_path, random_field_weights(("size", "angle")))
    with pytest.raises(ArtifactError, match="there is no network to put behind"):
        build_estimator(
            "field_network",
            Installation(T_s=1e-4, omega_n=314.0, V_base=1.0, Z_base=1.0, samples=1, sample_interval=1e-4),
        )
    with pytest.raises(StudyError, match="field_weight"):
        lc_study("50 ms", "[estimator]\nfield_weight = 3\n")
