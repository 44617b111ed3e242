"""Windows from EMT: they obey the grid they are labelled with, repeat to the bit, and survive a kill."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.simulation.studies import lc_study, lcl_study
from vsgdesign.errors import ArtifactError, InfeasibleStudyError, StudyError
from vsgdesign.estimator import specification
from vsgdesign.estimator.data_set import DataSet, read_data_set
from vsgdesign.estimator.recipes import CONTINUOUS, PUBLISHED
from vsgdesign.estimator.specification import WINDOW_NETWORK, WORK, generate
from vsgdesign.execution.journal import kept_count, kept_folder
from vsgdesign.study.parameters.ranges import log_uniform, one_of, uniform

STUDY = lc_study("1 s")
SMALL = replace(CONTINUOUS, name="small", bridge="averaged", scenarios=6, before=1, after=2, channels="alpha_beta")


def phasors(data: DataSet) -> tuple[np.ndarray, np.ndarray]:
    """v_pcc and i_pcc (N,) at the grid's frequency, as complex peak space vectors at the first sample."""
    parts = data.windows.reshape(len(data), 2, 2, data.samples)
    vectors = parts[:, :, 0] + 1j * parts[:, :, 1]
    turn = np.exp(-1j * data.omega_g[:, None] * data.sample_interval * np.arange(data.samples))
    return tuple((vectors * turn[:, None]).mean(axis=2).T)  # type: ignore[return-value]


def impedance_error(data: DataSet) -> np.ndarray:
    """Relative error of (v_pcc − v_g)/i_pcc against the label."""
    v, i = phasors(data)
    v_g = np.sqrt(2.0) * data.V_g_rms * np.exp(1j * data.source_phase)
    Z = data.R_g + 1j * data.omega_g * data.L_g
    return np.abs((v - v_g) / i / Z - 1.0)


@pytest.mark.parametrize("kind", ["lc", "lcl"])
def test_steady_windows_obey_ohms_law_of_their_labels(kind: str) -> None:
    """Before the change the averaged converter rests. What is left is the ripple of its held voltage, as sampled.

    The hold steps by VωT_s = 2.4 V; over L_1 that is ΔV·T_s/(12 L_1) = 5 mA, over R_c = 2 Ω 10 mV of some 10 V
    across the grid: 1e-3. Without R_c the capacitor sees it twice integrated.
    """
    study = lc_study("1 s") if kind == "lc" else lcl_study("1 s")
    recipe = replace(
        SMALL,
        after=0,
        before=2,
        x_over_r=log_uniform(0.7, 3.0),
        V_g_pu=uniform(0.97, 1.03),
        f_g_pu=uniform(0.999, 1.001),
        phase=uniform(0.0, 6.28),
    )
    data = generate(WINDOW_NETWORK, study, recipe, 5)
    assert impedance_error(data).max() < (2e-5 if kind == "lc" else 2e-3)
    assert len(np.unique(data.L_g)) == len(np.unique(data.V_g_rms)) == len(np.unique(data.omega_g)) == 6
    assert not data.synchronised
    c = study.converter
    # Droop and the frequency's deviation do not move the powers from where the recipe put them.
    for power, low, high in ((data.P, 0.3, 0.7), (data.Q, 0.1, 0.4)):
        assert low - 1e-6 < power.min() / c.S_rated < power.max() / c.S_rated < high + 1e-6
    assert not data.after_change.any()


def test_after_a_change_of_grid_the_label_is_the_new_grid() -> None:
    """Two windows on, the phasors move by a few per cent a cycle; with the old grid's label the error is above 10 %."""
    recipe = replace(SMALL, scenarios=8, scr=one_of(3.0, 9.0), grid_step_share=1.0, after=3, skip=2)
    data = generate(WINDOW_NETWORK, STUDY, recipe, 1)
    error = impedance_error(data)
    assert error[~data.after_change].max() < 2e-5
    assert error[data.after_change].max() < 0.08
    first = data.L_g[~data.after_change][data.scenario]
    assert np.all(first[data.after_change] != data.L_g[data.after_change])
    assert impedance_error(replace(data, L_g=first))[data.after_change].min() > 0.1


def test_some_scenarios_change_their_grid_and_not_by_more_than_the_ratio() -> None:
    """Of 40 at a share of 0.5, 20 ± 3 standard deviations (3.2)."""
    data = generate(WINDOW_NETWORK, STUDY, replace(SMALL, scenarios=40, grid_step_ratio=3.0), 0)
    L_g = data.L_g.reshape(40, 3)
    np.testing.assert_array_equal(L_g[:, 1], L_g[:, 2])
    ratio = L_g[:, 1] / L_g[:, 0]
    assert 10 <= np.sum(ratio != 1.0) <= 30
    assert 1.0 / 3.0 <= ratio.min() < 0.8
    assert 1.25 < ratio.max() <= 3.0
    with pytest.raises(InfeasibleStudyError, match="no second grid within a ratio of 3 of SCR 2"):
        generate(WINDOW_NETWORK, STUDY, replace(SMALL, scr=one_of(2.0), grid_step_ratio=3.0), 0)


def test_published_windows_are_synchronised_phase_a() -> None:
    data = generate(WINDOW_NETWORK, STUDY, replace(PUBLISHED, scenarios=5, before=1, after=1), 0)
    assert data.windows.shape == (10, 200)
    assert data.synchronised
    np.testing.assert_allclose(data.source_phase % (2.0 * np.pi), 1.5 * np.pi, atol=1e-8)
    scr = STUDY.converter.Z_base / (STUDY.converter.omega_n * data.L_g)
    np.testing.assert_allclose(scr[::2], [2.0, 4.5, 7.0, 9.5, 15.0], rtol=1e-12)
    np.testing.assert_allclose(data.R_g, STUDY.converter.omega_n * data.L_g, rtol=1e-12)
    np.testing.assert_array_equal(data.targets, np.stack([1e3 * data.L_g, data.R_g], axis=1))
    # Phase A's voltage leads the grid's zero crossing by the power angle, and has about 1.0 to 1.3 pu.
    v = data.windows[:, :100]
    assert np.all(np.abs(v).max(axis=1) > 150.0)
    assert np.all(v[:, 0] > 0.0)


def test_windows_that_are_no_whole_cycles_are_turned_back() -> None:
    """20.014 kHz on 50 Hz: 400.28 control periods in a cycle, so that windows of 400 begin 0.25° earlier each time."""
    study = replace(STUDY, converter=replace(STUDY.converter, f_sw=10.007e3))
    recipe = replace(SMALL, scenarios=2, after=8, every=3)
    data = generate(WINDOW_NETWORK, study, recipe, 0)
    assert (data.samples, data.header["recipe"]["cycles"]) == (100, 1)
    begins = data.source_phase % (2.0 * np.pi) - 1.5 * np.pi
    assert np.abs(begins).max() > 0.1
    v, i = phasors(data)
    v_g = np.sqrt(2.0) * data.V_g_rms * np.exp(-0.5j * np.pi)  # the same in every window
    Z = data.R_g + 1j * data.omega_g * data.L_g
    rest = ~data.after_change
    np.testing.assert_allclose(((v - v_g) / i)[rest], Z[rest], rtol=2e-5)
    unsynchronised = generate(WINDOW_NETWORK, study, replace(recipe, phase=one_of(0.3)), 0)
    v, i = phasors(unsynchronised)
    v_g = np.sqrt(2.0) * unsynchronised.V_g_rms * np.exp(1j * unsynchronised.source_phase)
    np.testing.assert_allclose(((v - v_g) / i)[rest], Z[rest], rtol=2e-5)


def test_the_published_recipe_makes_five_thousand() -> None:
    assert PUBLISHED.windows == CONTINUOUS.windows == 5000


def same(a: DataSet, b: DataSet) -> bool:
    return a.hash == b.hash


def test_nothing_but_study_recipe_and_seed_decides(tmp_path: Path) -> None:
    windows = replace(WINDOW_NETWORK, block=2)
    one = generate(windows, STUDY, SMALL, 7)
    with ThreadPoolExecutor(3) as executor:
        assert same(one, generate(windows, STUDY, SMALL, 7, executor=executor))
    windows = replace(WINDOW_NETWORK, block=5)
    assert same(one, generate(windows, STUDY, SMALL, 7, out=tmp_path / "w.npz"))
    assert same(one, read_data_set(tmp_path / "w.npz"))
    assert not same(one, generate(WINDOW_NETWORK, STUDY, SMALL, 8))
    # More scenarios leave the first ones as they were.
    more = generate(WINDOW_NETWORK, STUDY, replace(SMALL, scenarios=7), 7)
    np.testing.assert_array_equal(more.windows[: len(one)], one.windows)


def test_processes_make_the_same_windows(tmp_path: Path) -> None:
    windows = replace(WINDOW_NETWORK, block=3)
    shown: list[float] = []
    data = generate(
        windows, STUDY, SMALL, 7, out=tmp_path / "w.npz", workers=2, progress=lambda _, share: shown.append(share)
    )
    assert same(data, generate(WINDOW_NETWORK, STUDY, SMALL, 7))
    assert shown == [0.0, 0.5, 1.0]
    assert [path.name for path in tmp_path.iterdir()] == ["w.npz"]


def counting(monkeypatch: pytest.MonkeyPatch, stop_at: int = 10**9) -> list[range]:
    """Record the blocks made; at the given one, be interrupted."""
    made: list[range] = []
    original: Callable[..., Any] = specification.make_block

    def make(*arguments: Any) -> Any:
        if len(made) == stop_at:
            raise KeyboardInterrupt
        made.append(arguments[-1])
        return original(*arguments)

    monkeypatch.setattr(specification, "make_block", make)
    return made


def test_an_interrupted_call_is_taken_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    windows = replace(WINDOW_NETWORK, block=2)
    out = tmp_path / "w.npz"
    whole = generate(windows, STUDY, SMALL, 7)
    with monkeypatch.context() as patch:
        counting(patch, stop_at=2)
        with pytest.raises(KeyboardInterrupt):
            generate(windows, STUDY, SMALL, 7, out=out)
    assert not out.exists()
    (journal,) = kept_folder(out, WORK).glob("*.jsonl")
    assert kept_count(out, WORK) == 2
    journal.write_bytes(journal.read_bytes()[:-100])  # the kill came while it was written
    with monkeypatch.context() as patch:
        other = counting(patch)
        generate(windows, STUDY, SMALL, 8, out=tmp_path / "other.npz")
        assert len(other) == 3  # another seed takes nothing over
    with monkeypatch.context() as patch:
        made = counting(patch)
        assert same(generate(windows, STUDY, SMALL, 7, out=out), whole)
        assert made == [range(2, 4), range(4, 6)]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other.npz", "w.npz"]


def test_harmonics_noise_and_channels_reach_the_windows() -> None:
    plain = generate(WINDOW_NETWORK, STUDY, SMALL, 2)
    harmonic = generate(WINDOW_NETWORK, STUDY, replace(SMALL, harmonic_5=one_of(0.02), harmonic_7=one_of(0.01)), 2)
    parts = (harmonic.windows - plain.windows).reshape(len(plain), 2, 2, 100)
    lines = np.abs(np.fft.fft(parts[:, :, 0] + 1j * parts[:, :, 1], axis=2))
    assert np.all(np.argmax(lines[:, 0], axis=1) == 95)
    others = np.delete(lines, [7, 95], axis=2)
    assert others.max() < 1e-6 * lines.max()
    noisy = generate(WINDOW_NETWORK, STUDY, replace(SMALL, noise_i=one_of(0.01)), 2)
    np.testing.assert_array_equal(noisy.windows[:, :200], plain.windows[:, :200])
    assert (noisy.windows - plain.windows)[:, 200:].std() > 0.1
    assert generate(WINDOW_NETWORK, STUDY, replace(SMALL, channels="dq"), 2).windows.shape == (18, 400)


def test_a_recipe_that_no_grid_carries_is_refused() -> None:
    recipe = replace(SMALL, P_pu=one_of(2.0), Q_pu=one_of(-1.0), scr=one_of(1.2), grid_step_share=0.0)
    said = r"500 of 500 draws .* \(500 have no operating point\).* scr = 1.2, .* Raise the low end of scr"
    with pytest.raises(InfeasibleStudyError, match=said):
        generate(WINDOW_NETWORK, STUDY, recipe, 0)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"seed": -1}, "seed = -1: must be a whole number"),
        ({"seed": True}, "seed = True"),
        ({"workers": 0}, "workers = 0"),
        ({"recipe": replace(SMALL, scr=uniform(9.0, 2.0))}, r"scr.uniform = \[9.0, 2.0\]: the range is reversed"),
    ],
)
def test_bad_input_is_named(change: dict[str, Any], problem: str) -> None:
    arguments: dict[str, Any] = {"recipe": SMALL, "seed": 0, "workers": 1} | change
    with pytest.raises(StudyError, match=problem):
        generate(WINDOW_NETWORK, STUDY, arguments.pop("recipe"), arguments.pop("seed"), **arguments)


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match="is a folder"):
        generate(WINDOW_NETWORK, STUDY, SMALL, 0, out=tmp_path)
