"""A limiter is a choice: a second one, with a memory, runs through EMT and linear model from this file alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.simulation.studies import GAINS, lc_study, lcl_study
from vsgdesign.equations.controller import ControllerSettings, ControllerState, Measurement, controller_step
from vsgdesign.equations.controller_data import flat_state
from vsgdesign.equations.inner_loops import limit_length
from vsgdesign.equations.limiters import (
    CIRCULAR,
    LIMITERS,
    GridEstimate,
    IntegratorSteps,
    LimitedSample,
    Limiter,
    LimiterLaw,
    LimiterRatings,
    LimiterView,
    limiter_named,
)
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.errors import StudyError
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.simulation import FixedGains, GainChange, MeasuredWindow, Recorder, Simulation, simulate
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import Grid, Study, study_from_text

SAG = """
[[events]]
time = "10 ms"
V_g_pu = 0.3
[[events]]
time = "40 ms"
V_g_pu = 1.0
"""


class Memory(NamedTuple):
    """How much the limiter has cut of late, A peak, and the frequency of the last sample, rad/s."""

    cut: Any
    omega: Any


class Constants(NamedTuple):
    share: Any
    """Of the way that the memory goes in a sample."""
    pull: Any
    """rad/s² per A."""
    X_2: Any


class Notes(NamedTuple):
    cut: Any
    gate: Any


def constants(ratings: LimiterRatings, values: Mapping[str, float]) -> Constants:  # noqa: ARG001
    return Constants(share=ratings.T_s / 5e-3, pull=2.0 / ratings.I_rated_pk, X_2=ratings.omega_0 * ratings.L_2)


def at_rest(view: LimiterView, omega: Any, settings: ControllerSettings) -> Memory:  # noqa: ARG001
    return Memory(cut=0.0, omega=omega)


def reactance(grid: GridEstimate, omega: Any) -> Any:
    """A function of this module that the law calls: it has to be compiled too."""
    return omega * grid.L_g


def limit(
    memory: Memory,
    view: LimiterView,
    grid: GridEstimate,
    refs: References,
    gains: PowerLoopGains,  # noqa: ARG001
    settings: ControllerSettings,
) -> LimitedSample:
    """Circular; while it cuts, P is held at its reference and only half of the error is taken up."""
    i_d, i_q = limit_length(view.i_want_d, view.i_want_q, settings.i_max_pk)
    length_sq = view.i_want_d * view.i_want_d + view.i_want_q * view.i_want_q
    limited = 1.0 * (length_sq > settings.i_max_pk * settings.i_max_pk)
    cut_d, cut_q = view.i_want_d - i_d, view.i_want_q - i_q
    # On a strong grid it pulls less: the estimate has a say.
    X = settings.limiter.X_2 + reactance(grid, memory.omega)
    return LimitedSample(
        i_ref_d=i_d,
        i_ref_q=i_q,
        e_d=(1.0 - 0.5 * limited) * view.e_d,
        e_q=(1.0 - 0.5 * limited) * view.e_q,
        P=view.P + limited * (refs.P_ref - view.P),
        Q=view.Q,
        limited=limited,
        notes=Notes(cut=np.sqrt(np.maximum(cut_d * cut_d + cut_q * cut_q, 1e-12 * limited)), gate=X / (X + 1.0)),
    )


def move(
    memory: Memory,
    sample: LimitedSample,
    view: LimiterView,  # noqa: ARG001
    omega: Any,
    steps: IntegratorSteps,
    settings: ControllerSettings,
) -> Any:
    c = settings.limiter
    pull = settings.T_s * c.pull * sample.notes.gate * memory.cut
    remembered = Memory(cut=memory.cut + c.share * (sample.notes.cut - memory.cut), omega=omega)
    return IntegratorSteps(theta=steps.theta, omega_i=steps.omega_i - pull, V=steps.V), remembered


LEANING = Limiter("leaning", LimiterLaw(limit, move), constants, at_rest)


@pytest.fixture
def leaning(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setitem(LIMITERS, LEANING.name, LEANING)
    return LEANING.name


def with_limiter(build: Callable[..., Study], name: str, limit_pu: float | None = 1.2, **words: Any) -> Study:
    study = build("60 ms", SAG, **words)
    return replace(study, current_limiter=name, converter=replace(study.converter, current_limit_pu=limit_pu))


def run(study: Study, bridge: str = "averaged") -> Simulation:
    return simulate(study, [GainChange(0.0, GAINS)], bridge=bridge, log_states=10**6)


def by_hand(study: Study, found: Simulation) -> tuple[np.ndarray, int]:
    """The controller again in plain Python along the logged measurements, and how often it was limited."""
    state = found.final_state  # for its types; the values come from the log
    memory_type, settings = type(state.limiter), study.controller_settings()
    grid = GridEstimate(R_g=study.grid.R_g, L_g=study.grid.L_g)
    refs = References(
        P_ref=study.simulation.P_ref,
        Q_ref=study.simulation.Q_ref,
        omega_0=study.converter.omega_n,
        V_n=study.converter.V_rated_rms,
    )
    R_c, following, limited = study.filter.R_c, [], 0.0
    own = len(memory_type._fields)
    for row, values in zip(found.log, found.controller_log, strict=True):
        i_s, v_c, i_g = row[0:2], row[2:4], row[4:6]
        measured = Measurement(*(v_c + R_c * (i_s - i_g)), *i_s, *i_g)
        plain = ControllerState(*values[: len(values) - own], limiter=memory_type(*values[len(values) - own :]))
        after, output = controller_step(
            plain, measured, grid, refs, GAINS, study.inner_gains, settings, study.limiter.law
        )
        following.append(flat_state(after))
        limited += output.limited
    return np.array(following, dtype=float), int(limited)


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
@pytest.mark.parametrize("name", [*LIMITERS, "leaning"])
def test_the_compiled_run_is_the_plain_law(leaning: str, name: str, bridge: str) -> None:  # noqa: ARG001
    """Every sample of a sag into the limit: memory, action on ω_i and P, and the count of limited samples."""
    study = with_limiter(lc_study, name)
    found = run(study, bridge)
    expected, limited = by_hand(study, found)
    now, later = expected[:-1], found.controller_log[1:]
    turned = np.exp(1j * now[:, 0]) - np.exp(1j * later[:, 0])
    scale = np.maximum(np.abs(later[:, 1:]).max(axis=0), 1e-9)
    assert np.abs(turned).max() < 1e-12
    assert np.max(np.abs(now[:, 1:] - later[:, 1:]) / scale) < 1e-11
    assert 50 < limited == found.column("limited_samples")[-1]


def test_its_action_shows_and_its_memory_is_kept(leaning: str) -> None:
    circular, other = run(with_limiter(lc_study, "circular")), run(with_limiter(lc_study, leaning))
    assert other.controller_log.shape[1] == circular.controller_log.shape[1] + 2
    assert other.final_state.limiter._fields == Memory._fields
    assert other.controller_log[:, -2].max() > 0.1  # A cut
    slowed = circular.final_state.omega_i - other.final_state.omega_i
    assert abs(slowed) > 1e-3


def test_limited_samples_are_counted_from_the_start_whatever_is_logged() -> None:
    """Also those between two rows: the count of a coarse log is that of the fine one."""
    fine = run(with_limiter(lc_study, "circular"))
    coarse = run(with_limiter(lc_study, "circular", log="350 us"))
    counts = fine.column("limited_samples")
    assert set(np.diff(counts)) == {0.0, 1.0}
    np.testing.assert_array_equal(coarse.column("limited_samples"), counts[::7])
    c = with_limiter(lc_study, "circular").converter
    i_s = np.hypot(fine.log[:, 0], fine.log[:, 1])
    assert counts[i_s < 0.9 * c.I_rated_pk][0] == 0.0


STEP = '[[events]]\ntime = "10 ms"\nP_ref = "2.5 kW"\n'


@pytest.mark.parametrize("build", [lc_study, lcl_study])
@pytest.mark.parametrize("name", [*LIMITERS, "leaning"])
def test_a_limit_out_of_reach_changes_no_bit(name: str, build: Callable[..., Study], leaning: str) -> None:  # noqa: ARG001
    """The same compiled law with its limits on and off: logs and every state are equal to the last bit."""
    plain = replace(build("60 ms", STEP), current_limiter=name)
    off = run(replace(plain, converter=replace(plain.converter, current_limit_pu=None)))
    on = run(replace(plain, converter=replace(plain.converter, current_limit_pu=3.0)))
    assert on.column("limited_samples")[-1] == 0.0
    assert on.log.tobytes() == off.log.tobytes()
    assert on.controller_log.tobytes() == off.controller_log.tobytes()


@pytest.mark.parametrize("build", [lc_study, lcl_study])
@pytest.mark.parametrize("name", [*LIMITERS, "leaning"])
def test_every_limiter_is_the_same_controller_inside_its_limits(
    name: str,
    build: Callable[..., Study],
    leaning: str,  # noqa: ARG001
) -> None:
    """Against the circular limit only the rounding of fused operations differs: 1e-12 of the largest value."""
    plain = build("60 ms", STEP)
    circular, other = run(plain), run(replace(plain, current_limiter=name))
    scale = np.abs(circular.log).max(axis=0) + 1e-9
    assert np.max(np.abs(other.log - circular.log) / scale) < 1e-12


@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_the_linear_model_has_its_memory_as_states(build: Callable[..., Study], leaning: str) -> None:
    """One state for each field, at rest a fixed point; the others' modes are those without it."""
    cell = Cell(build("10 ms").grid, GAINS, 2000.0, 500.0)
    circular = linearise_full_order(with_limiter(build, "circular", 8.0), [cell])
    other = linearise_full_order(with_limiter(build, leaning, 8.0), [cell])
    assert other.faults == circular.faults == (None,)
    assert other.states == (*circular.states, "limiter_cut", "limiter_omega")
    after = np.array(other.map.step(other.z[0], other.p[0])[0])[:, 0]
    np.testing.assert_allclose(after, other.z[0], rtol=1e-9, atol=1e-9)
    count = len(circular.states)
    np.testing.assert_array_equal(other.A[0][:count, :count], circular.A[0])
    # The memory of what was cut fades by its own share in every sample and leans on the frequency integrator.
    share = with_limiter(build, leaning).controller_settings().limiter.share
    assert other.A[0][count, count] == pytest.approx(1.0 - share, rel=1e-12)
    assert other.A[0][other.states.index("omega_i"), count] < 0.0


def test_a_study_names_it(leaning: str) -> None:
    assert lc_study("1 ms").limiter is CIRCULAR
    named = lc_study("1 ms", sections=f'[converter]\ncurrent_limiter = "{leaning}"\n')
    assert named.limiter is LEANING
    assert isinstance(named.controller_settings().limiter, Constants)


def test_an_unknown_name_raises_one_clear_error() -> None:
    with pytest.raises(ValueError, match='current_limiter = "square": must be one of circular'):
        limiter_named("square")
    with pytest.raises(StudyError, match="1 fault") as caught:
        lc_study("1 ms", sections='[converter]\ncurrent_limiter = "square"\n')
    assert "converter.current_limiter" in str(caught.value)
    assert "circular" in str(caught.value)


def test_a_window_says_in_how_many_of_its_samples_the_current_was_limited() -> None:
    """Every sample of the controller counts once, also those that the window does not hold."""
    study = with_limiter(lc_study, "circular")
    recorder = Recorder(FixedGains(GAINS, update_period=5e-3, sample_interval=200e-6))
    found = simulate(study, recorder, bridge="averaged")
    counts = found.column("limited_samples")
    ends = [round(window.t_s / study.converter.T_s) for window in recorder.windows]
    assert [window.limited for window in recorder.windows] == list(np.diff([0.0, *counts[np.array(ends) - 1]]))
    assert sum(window.limited for window in recorder.windows) > 50


class Scheduled:
    """A scheduler that says which grid its gains are for."""

    update_period, sample_interval = 5e-3, 200e-6

    def __init__(self, grid: Grid) -> None:
        self.grid = grid

    def first_gains(self) -> PowerLoopGains:
        return GAINS

    def update(self, window: MeasuredWindow) -> PowerLoopGains | None:  # noqa: ARG002
        return None


def test_it_is_told_the_grid_that_the_gains_are_for(leaning: str) -> None:
    """Of a scheduler, of listed gains, and without either the study's own."""
    study = with_limiter(lc_study, leaning)
    other = Grid(study.grid.R_g, 5.0 * study.grid.L_g)
    own = run(study).controller_log
    listed = simulate(study, [GainChange(0.0, GAINS, other)], log_states=10**6, bridge="averaged").controller_log
    scheduled = simulate(study, Scheduled(other), log_states=10**6, bridge="averaged").controller_log
    # The runs are cut at other samples, which changes the rounding of the source's turning.
    assert np.max(np.abs(listed[:, 1] - scheduled[:, 1])) < 1e-10
    assert np.max(np.abs(listed[:, 1] - own[:, 1])) > 1e-5


OWN = """
base = "case:hoang2025_5kva"
converter = { current_limit_pu = 0.9 }
simulation = { duration = "60 ms", bridge = "averaged", log_interval = "50 us", P_ref = "2 kW", Q_ref = "0 var" }
controllers = [
    { name = "as-given", kind = "scheduled" },
    { name = "lower", kind = "scheduled", current_limit_pu = 0.7 },
    { name = "free", kind = "scheduled", current_limiter = "none" },
]
events = [{ time = "10 ms", V_g_pu = 0.3 }, { time = "59 ms", V_g_pu = 1 }]
"""


def test_each_controller_has_its_own_limit() -> None:
    """It runs as in a study whose converter has that limit, to the bit."""
    found = {c.spec.name: c.simulation for c in run_scenario(study_from_text(OWN)).controllers}
    limits = {"as-given": "current_limit_pu = 0.9", "lower": "current_limit_pu = 0.7", "free": ""}
    for name, limit in limits.items():
        alone = study_from_text(OWN.replace("current_limit_pu = 0.9", limit).replace(", current_limit_pu = 0.7", ""))
        one = next(c.simulation for c in run_scenario(alone).controllers if c.spec.name == "as-given")
        assert np.array_equal(found[name].log, one.log), name
    acted = {name: run.column("limited_samples")[-1] > 0 for name, run in found.items()}
    assert acted == {"as-given": True, "lower": True, "free": False}
    assert np.ptp(found["free"].log[:, 0] - found["lower"].log[:, 0]) > 0.1


@pytest.mark.parametrize(
    ("controller", "said"),
    [
        ('current_limiter = "square"', 'controllers[0].current_limiter = "square": must be one of "none", "circular"'),
        ('current_limiter = "none", current_limit_pu = 1.2', "has no effect"),
        ('current_limiter = "circular"', "Add current_limit_pu, for example 1.2"),
        ("current_limit_pu = 0.1", "0.5"),
    ],
)
def test_a_limit_that_a_controller_cannot_have(controller: str, said: str) -> None:
    text = OWN.split("controllers")[0].replace("converter = { current_limit_pu = 0.9 }\n", "")
    with pytest.raises(StudyError) as caught:
        study_from_text(f'{text}controllers = [{{ name = "a", kind = "scheduled", {controller} }}]')
    assert said in str(caught.value)
