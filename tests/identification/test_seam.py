"""An estimator that is added here, in a test alone: a study runs with it, a page shows it, the comparison judges it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from vsgdesign.errors import ArtifactError, StudyError
from vsgdesign.estimator.comparison import compare_methods
from vsgdesign.estimator.methods import ComparisonSettings
from vsgdesign.identification import ESTIMATORS, Estimate, EstimatorKind, Installation, Needs, Probe, Samples
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import load_study, study_from_text
from vsgdesign.verbs.pipeline.run import run_study

ANSWER = (0.9, 2.9e-3)

TEXT = """
base = "case:hoang2025_5kva"
simulation = { duration = "0.2 s", P_ref = "2 kW", Q_ref = "1 kvar" }
controllers = [{ name = "own", kind = "scheduled", estimate = "own" }]
events = [{ time = "0.1 s", grid = { scr = 8 } }]
"""


class Seen(NamedTuple):
    """Windows so far, and the largest probe that was sent."""

    windows: int
    sent: float


@dataclass(frozen=True, eq=False)
class Own:
    """Always one answer; a small probe in the first three windows, twice as large afterwards."""

    at: Installation
    quantity: str = "voltage"
    title: str = "A test's own"
    signals: str = "other"

    def __post_init__(self) -> None:
        probes = [Probe(np.array([a, -a], dtype=complex), self.at.window / 20, self.quantity) for a in (1e-3, 2e-3)]
        object.__setattr__(self, "probes", tuple(probes))

    @property
    def needs(self) -> Needs:
        return Needs(self.at.samples, self.at.sample_interval, probe_hold=self.at.window / 20)

    def first(self) -> Seen:
        return Seen(0, 0.0)

    def probe(self, state: Seen) -> Probe:
        return self.probes[int(state.windows >= 3)]  # type: ignore[attr-defined]

    def update(self, state: Seen, samples: Samples) -> tuple[Seen, Estimate]:
        sent = float(np.abs(samples.sent).max())
        return Seen(state.windows + 1, sent), Estimate(ANSWER[0], ANSWER[1], "ok", np.diag([sent**2, 1e-12]))


@pytest.fixture
def own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ESTIMATORS, "own", EstimatorKind("a test's own estimator", Own))


@pytest.fixture
def no_other_probe(monkeypatch: pytest.MonkeyPatch) -> None:
    """A comparison runs every case once for each probe; those of the package are compared in another test."""
    for name in ("injection", "prbs", "field", "field_network"):
        monkeypatch.delitem(ESTIMATORS, name)


@pytest.mark.usefixtures("own")
def test_a_study_runs_with_it_and_the_page_says_so(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(TEXT)
    run_study(load_study(tmp_path / "study.toml"), tmp_path / "out", report="still")
    rows = np.genfromtxt(tmp_path / "out" / "own.estimates.csv", delimiter=",", skip_header=1)
    np.testing.assert_allclose(rows[:, 3:5], [ANSWER] * 10)
    # The probe as sent, which the estimator gave back as a deviation: what it asked for after its third window.
    np.testing.assert_allclose(rows[:, 6], [1e-3] * 3 + [2e-3] * 7)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "by a test&#39;s own estimator; its gains follow 10 of 10 estimates." in page
    assert "0.2 % of the rated voltage" not in page
    assert "0.1 % of the rated voltage" in page


@pytest.mark.usefixtures("own")
def test_its_estimate_is_what_the_gains_follow() -> None:
    (run,) = run_scenario(study_from_text(TEXT)).controllers
    assert [change.t_s for change in run.gain_changes] == pytest.approx([0.0, 0.02])


@pytest.mark.usefixtures("own", "no_other_probe")
def test_the_comparison_judges_it() -> None:
    study = load_study("studies/published/study.toml")
    found = compare_methods(study, {}, ComparisonSettings(scr=(8.0,), grid_steps=(), draws=1))
    one = next(one for one in found.accuracy if one.method == "A test's own")
    Z = study.converter.Z_base / 8.0 * (1.0 + 1.0j)
    error = abs(ANSWER[0] + 1j * study.converter.omega_n * ANSWER[1] - Z) / abs(Z)
    assert one.rms[0] == pytest.approx(error, rel=1e-3)
    assert np.isnan(one.bound[0])
    assert "A test's own" in {disturbance.method for disturbance in found.disturbances}


def test_a_probe_of_power_moves_the_references(monkeypatch: pytest.MonkeyPatch) -> None:
    """2 ‰ of 5 kVA, ±10 W in turns of a millisecond: the run's own power loops see another reference, no more."""

    def power(at: Installation) -> Own:
        return Own(at, "power")

    plain = TEXT.replace('"own" }', '"constant" }').replace('name = "own"', 'name = "a"')
    quiet = run_scenario(study_from_text(plain)).controllers[0]
    monkeypatch.setitem(ESTIMATORS, "own", EstimatorKind("a test's own estimator", power))
    moved = run_scenario(study_from_text(TEXT)).controllers[0]
    K_ip = quiet.gain_changes[0].gains.K_ip
    # The frequency's integrator sees ±ΔP for 1 ms each: a triangle of K_ip·ΔP·1 ms on ω, after the steady start.
    first = slice(0, 100)
    swing = np.ptp((moved.series["omega"] - quiet.series["omega"])[first])
    assert swing == pytest.approx(K_ip * 5.0 * 1e-3, rel=0.2)


def test_without_it_the_name_is_a_fault_with_the_known_ones() -> None:
    with pytest.raises(StudyError, match=r"controllers\[0\]\.estimate = \"own\".*truth.*kalman"):
        study_from_text(TEXT)


class Passed(NamedTuple):
    """Samples so far."""

    samples: int


@dataclass(frozen=True, eq=False)
class SampleBySample:
    """Fed with one sample at a time; an answer at the end of every window of the installation."""

    at: Installation
    title: str = "Sample by sample"
    signals: str = "other"

    @property
    def needs(self) -> Needs:
        return Needs(1, self.at.sample_interval)

    def first(self) -> Passed:
        return Passed(0)

    def probe(self, state: Passed) -> None:
        pass

    def update(self, state: Passed, samples: Samples) -> tuple[Passed, Estimate | None]:
        seen = state.samples + 1
        assert samples.v.shape == (2, 1)
        return Passed(seen), Estimate(*ANSWER, "ok") if seen % self.at.samples == 0 else None


@pytest.mark.usefixtures("no_other_probe")
def test_an_estimator_may_be_fed_sample_by_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    """The guards and the log see its answers alone, one a window, in a run as in the comparison."""
    monkeypatch.setitem(ESTIMATORS, "own", EstimatorKind("sample by sample", SampleBySample))
    (run,) = run_scenario(study_from_text(TEXT)).controllers
    assert run.estimates is not None
    np.testing.assert_allclose(run.estimates.t_s, 0.02 * np.arange(1, 11))
    assert run.estimates.period == pytest.approx(0.02)
    assert [change.t_s for change in run.gain_changes] == pytest.approx([0.0, 0.02])
    study = load_study("studies/published/study.toml")
    found = compare_methods(study, {}, ComparisonSettings(scr=(8.0,), grid_steps=(), draws=1))
    one = next(one for one in found.accuracy if one.method == "Sample by sample")
    other = abs(
        complex(ANSWER[0], study.converter.omega_n * ANSWER[1]) / (study.converter.Z_base / 8.0 * (1 + 1j)) - 1.0
    )
    assert one.rms[0] == pytest.approx(other, rel=1e-3)


def test_a_status_that_nobody_knows_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    class Wrong(Own):
        def update(self, state: Seen, samples: Samples) -> tuple[Seen, Estimate]:
            state, found = super().update(state, samples)
            return state, found._replace(status="fine")

    monkeypatch.setitem(ESTIMATORS, "own", EstimatorKind("a test's own estimator", Wrong))
    with pytest.raises(
        ArtifactError, match=r"A test's own: its estimate has the status 'fine'\. The known ones are ok, "
    ):
        run_scenario(study_from_text(TEXT))
