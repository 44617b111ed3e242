"""[estimator.probe]: read, and every fault named at once."""

from __future__ import annotations

import pytest

from vsgdesign.errors import StudyError
from vsgdesign.identification.field import ProbeLimits
from vsgdesign.study.parameters import Study, study_from_text


def study(probe: str, estimate: str = "field") -> Study:
    return study_from_text(f"""
base = "case:hoang2025_5kva"
simulation = {{ duration = "1 s", P_ref = "2 kW", Q_ref = "0 var" }}
controllers = [{{ name = "a", kind = "scheduled", estimate = "{estimate}" }}]
estimator = {{ probe = {probe} }}
""")


def test_it_is_read() -> None:
    spec = study('{ sigma = "2 %", amplitude = "0.1 %", code = 7 }').estimator
    assert spec is not None
    assert spec.probe is not None
    assert (spec.probe.send, spec.probe.code, spec.probe.pair) == (True, 7, 1)
    assert spec.probe.limits == ProbeLimits(sigma=0.02, amplitude=0.001)


def test_every_fault_is_named() -> None:
    with pytest.raises(StudyError) as caught:
        study(
            '{ amplitude = 0.003, amplitude_burst = 0.001, ripple = "2 kW", sigm = 1, code = -1, pair = 5, send = 2 }'
        )
    for text in ("amplitude_burst = ", "ripple = ", "sigm: unknown field", "code = -1", "pair = 5", "send = 2"):
        assert f"estimator.probe.{text}" in str(caught.value)


@pytest.mark.parametrize(
    ("probe", "estimate", "said"),
    [
        ('{ send = false, sigma = "2 %" }', "field", "has no effect with send = false"),
        ("{ send = false }", "rls", "no controller has a field estimator"),
        ("3", "field", "expected a table"),
    ],
)
def test_what_cannot_act_is_refused(probe: str, estimate: str, said: str) -> None:
    with pytest.raises(StudyError, match=said):
        study(probe, estimate)
