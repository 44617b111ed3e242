"""Series that are written as COMTRADE, read by the `comtrade` package to the resolution of each form."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import comtrade
import numpy as np
import pytest

from tests.cli.small_studies import call, failure, study_file
from vsgdesign.artifacts.time_series import FORMS, UNITS, read_npz, write_comtrade
from vsgdesign.campaigns.compliance.evidence import RECORDED, read_evidence
from vsgdesign.equations.frames import clarke, rms_to_peak
from vsgdesign.errors import ArtifactError
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.record import read_record
from vsgdesign.verbs.cli.run import simulate

COUNT = 3000
RATE = 12_800.0


def made() -> dict[str, np.ndarray]:
    """Series of every size: waves, a power, an impedance that is not known at first, and what never moves."""
    random = np.random.default_rng(31)
    t_s = np.arange(COUNT) / RATE
    series = {"t_s": t_s}
    series |= {f"v_pcc_{p}": 155.0 * np.cos(314.0 * t_s - 2.1 * k) for k, p in enumerate("abc")}
    series |= {"P_pcc": 5e3 + 1e-3 * random.standard_normal(COUNT), "omega": np.full(COUNT, 314.159)}
    series |= {"L_g": np.full(COUNT, 0.0), "R_g_hat": np.where(t_s < 0.05, np.nan, 0.2 + 1e-4 * t_s)}
    return series


def loaded(path: Path) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return comtrade.load(str(path), use_double_precision=True, use_numpy_arrays=True)


@pytest.mark.parametrize("form", FORMS)
def test_the_package_reads_every_series_to_the_forms_resolution(tmp_path: Path, form: str) -> None:
    series = made()
    write_comtrade(tmp_path / "run", series, form, f_n=50.0, station="study", trigger_s=0.1)
    other = loaded(tmp_path / ("run.cff" if form == "cff" else "run.cfg"))
    assert other.analog_channel_ids == [name for name in series if name != "t_s"]
    assert [one.uu for one in other.cfg.analog_channels] == [UNITS[name] for name in other.analog_channel_ids]
    assert other.analog_phases[:4] == ["A", "B", "C", ""]
    assert other.cfg.sample_rates == [[RATE, COUNT]]
    assert (other.station_name, other.frequency) == ("study", 50.0)
    assert other.trigger_time == pytest.approx(0.1, abs=1e-9)
    np.testing.assert_allclose(other.time, series["t_s"], atol=1e-12)
    for name, found in zip(other.analog_channel_ids, other.analog, strict=True):
        wanted = series[name]
        assert np.array_equal(np.isnan(found), np.isnan(wanted)), name
        span = float(np.nanmax(wanted) - np.nanmin(wanted))
        steps = {"ascii": 2 * 99_998, "binary": 2 * 32_767}.get(form)
        # Half a step of whole numbers, or half a unit in the last place of 24 bits.
        limit = 0.5 * span / steps if steps else 2.0**-24 * float(np.nanmax(np.abs(wanted)))
        rounding = 4e-16 * float(np.nanmax(np.abs(wanted)))
        assert np.nanmax(np.abs(found - wanted)) <= limit + rounding, name


@pytest.mark.parametrize("form", FORMS)
def test_a_record_can_be_played_again(tmp_path: Path, form: str) -> None:
    series = made()
    write_comtrade(tmp_path / "run", series, form, f_n=50.0, station="study", trigger_s=0.1)
    path = tmp_path / ("run.cff" if form == "cff" else "run.cfg")
    record = read_record(str(path), ("v_pcc_a", "v_pcc_b", "v_pcc_c"), None)
    assert record.rate == RATE
    other = loaded(path)
    np.testing.assert_allclose(record.values.T, np.array(other.analog[:3]), rtol=1e-14, atol=1e-13)


def test_long_runs_and_odd_ones(tmp_path: Path) -> None:
    """Times count in ms where 32 bits of µs end, 71 minutes after the beginning."""
    t_s = np.linspace(0.0, 4000.0, 5)
    write_comtrade(tmp_path / "long", {"t_s": t_s, "omega": t_s}, "binary", f_n=50.0, station="a,b", trigger_s=0.0)
    other = loaded(tmp_path / "long.cfg")
    assert other.station_name == "a b"
    np.testing.assert_allclose(other.time, t_s)
    rows = np.frombuffer((tmp_path / "long.dat").read_bytes(), dtype="<u4,<u4,<i2")
    assert rows["f1"].tolist() == [0, 1000000, 2000000, 3000000, 4000000]
    assert other.cfg.timemult == 1000.0
    with pytest.raises(ArtifactError, match=r'"wav" is no form of COMTRADE\. Known: ascii, binary, float32, cff'):
        write_comtrade(tmp_path / "x", made(), "wav", f_n=50.0, station="s", trigger_s=0.0)
    with pytest.raises(ArtifactError, match="two samples or more, and the run has 1"):
        write_comtrade(tmp_path / "x", {"t_s": t_s[:1]}, "ascii", f_n=50.0, station="s", trigger_s=0.0)


def test_simulate_writes_it_beside_the_others(tmp_path: Path) -> None:
    option = next(one for one in simulate.params if one.name == "comtrade")
    assert tuple(getattr(option.type, "choices", ())) == FORMS
    study = study_file(tmp_path)
    assert call("simulate", study, "--out", tmp_path / "out", "--comtrade", "binary").exit_code == 0
    record = min((tmp_path / "out").glob("*.cfg"))
    series, other = read_npz(record.with_suffix(".npz")), loaded(record)
    for name, found in zip(other.analog_channel_ids, other.analog, strict=True):
        wanted = series[name]
        limit = 0.5 * np.ptp(wanted) / 65_534 + 2.0**-23 * np.max(np.abs(wanted))
        assert np.max(np.abs(found - wanted)) <= limit, name
    assert "'pdf' is not one of 'ascii', 'binary'" in failure(2, "simulate", study, "--comtrade", "pdf")


SUITE = """
title = "One test"
[[criteria]]
measure = "survived"
at_least = 1
[[tests]]
name = "phase jump"
scr = 5
x_over_r = 3
events = [{ phase_jump = "30 deg" }]
"""


def test_comply_writes_every_row_of_a_run(tmp_path: Path) -> None:
    """In SI and not thinned, while the CSV has fewer rows in pu."""
    study, suite = study_file(tmp_path), tmp_path / "one.toml"
    suite.write_text(SUITE, encoding="utf-8")
    out = tmp_path / "out"
    asked = ("--suite", suite, "--no-maps", "--cases", "none", "--workers", "1", "--out", out)
    assert call("comply", study, *asked, "--comtrade", "float32").exit_code == 0
    records = sorted((out / "traces").glob("*.cfg"))
    assert len(records) == len(list((out / "traces").glob("*.csv"))) > 0
    c = load_study(study).converter
    for record in records:
        other, trace = loaded(record), read_evidence(record.with_suffix(".csv")).trace
        found = dict(zip(other.analog_channel_ids, other.analog, strict=True))
        assert list(found) == list(RECORDED)
        assert len(other.time) > len(trace.t_s)
        begin = trace.t_s[0]
        for name, wanted in {"P": c.S_rated * trace.P_pu, "f": trace.f_hz}.items():
            there = np.interp(trace.t_s - begin, other.time, found[name])
            assert np.max(np.abs(there - wanted)) <= 2e-6 * max(np.max(np.abs(wanted)), 1.0), name
        v_alpha, _ = clarke(found["v_a"], found["v_b"], found["v_c"])
        wanted = rms_to_peak(c.V_rated_rms) * trace.v_alpha_pu
        assert np.max(np.abs(np.interp(trace.t_s - begin, other.time, v_alpha) - wanted)) <= 2e-6 * np.max(wanted)
