"""COMTRADE as a recorded source: against the `comtrade` package, and every fault of a record by its sentence."""

from __future__ import annotations

import warnings
from pathlib import Path

import comtrade
import numpy as np
import pytest

from tests.simulation.comtrade_files import RATE, channel, config, samples, write
from tests.simulation.test_replay import V, said, study_with, voltage
from vsgdesign.simulation import build_timeline
from vsgdesign.study.parameters.record import read_record, record_files
from vsgdesign.study.parameters.record_columns import RecordError

PHASES = ("va", "vb", "vc")
COUNT = 2000


def counts(count: int = COUNT, per_count: float = 0.05) -> np.ndarray:
    """Whole numbers of a voltage, three phases, and of a current beside it."""
    t_s = np.arange(count) / RATE
    waves = [voltage(t_s, k) / per_count for k in range(3)] + [900.0 * np.sin(2.0 * np.pi * 50.0 * t_s)]
    return np.rint(np.stack(waves, axis=1)).astype(int)


def lines(**changed: object) -> list[str]:
    """Channels whose count is 0.05 V, and a current."""
    described = {"uu": "kV", "a": 5e-5} | changed
    return [*(channel(k + 1, name, **described) for k, name in enumerate(PHASES)), channel(4, "ia", uu="A", a=0.01)]


def faults(path: Path, columns: tuple[str, ...] | None = None, rate: float | None = None) -> str:
    with pytest.raises(RecordError) as error:
        read_record(str(path), columns, rate)
    return "\n".join(f"{field}: {problem}. {advice}" for field, problem, advice in error.value.faults)


@pytest.mark.parametrize("year", ["1991", "1999", "2013"])
@pytest.mark.parametrize("form", ["ASCII", "BINARY", "BINARY32", "FLOAT32"])
def test_every_form_is_read_as_the_package_reads_it(tmp_path: Path, form: str, year: str) -> None:
    """To the last bit of double precision, and in V where the file says kV."""
    path = write(tmp_path, config(lines(b=0.0125), COUNT, form, year), samples(counts(), form))
    record = read_record(str(path), None, None)
    assert record.rate == RATE
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        other = comtrade.load(str(path), use_double_precision=True, use_numpy_arrays=True)
    np.testing.assert_allclose(record.values.T, 1e3 * np.array(other.analog[:3]), rtol=1e-14, atol=1e-13)
    np.testing.assert_allclose(record.values, 0.05 * counts()[:, :3] + 12.5, rtol=1e-13, atol=1e-12)
    assert np.array_equal(read_record(str(tmp_path / "event.dat"), ("1", "vb", "3"), None).values, record.values)
    assert {Path(one).name for one in record_files(str(path))} == {"event.cfg", "event.dat"}


@pytest.mark.parametrize("form", ["ASCII", "BINARY", "FLOAT32"])
@pytest.mark.parametrize("sized", [False, True])
def test_a_single_file_is_the_same_record(tmp_path: Path, form: str, sized: bool) -> None:
    cfg, dat = config(lines(), COUNT, form, "2013"), samples(counts(), form)
    size = f": {len(dat)}" if sized else ""
    head = f"--- file type: CFG ---\r\n{cfg}--- file type: INF ---\r\n\r\n--- file type: DAT {form}{size} ---\r\n"
    (tmp_path / "event.cff").write_bytes(head.encode() + dat)
    record = read_record(str(tmp_path / "event.cff"), None, None)
    whole = read_record(str(write(tmp_path, cfg, dat)), None, None)
    assert record.rate == whole.rate
    assert np.array_equal(record.values, whole.values)


def test_the_secondary_side_is_turned_into_the_primary_one(tmp_path: Path) -> None:
    """A ratio of 20 kV : 100 V. One count is 0.05 V on the primary side in both records."""
    primary = write(tmp_path, config(lines(), COUNT, "BINARY"), samples(counts(), "BINARY"), "primary")
    changed = {"uu": "V", "a": 0.05 / 200.0, "primary": 20000, "secondary": 100, "PS": "S"}
    path = write(tmp_path, config(lines(**changed), COUNT, "BINARY"), samples(counts(), "BINARY"), "secondary")
    values = [read_record(str(one), None, None).values for one in (primary, path)]
    np.testing.assert_allclose(values[1], values[0], rtol=1e-13)
    changed["secondary"] = 0
    path = write(tmp_path, config(lines(**changed), COUNT, "BINARY"), samples(counts(), "BINARY"))
    assert '"va" is of the secondary side, and its .cfg does not say the ratio of its transformer' in faults(path)


def test_a_study_plays_it(tmp_path: Path) -> None:
    """The voltage at every sample of the controller, against the wave itself; half a count is 0.025 V."""
    path = write(tmp_path, config(lines(), COUNT, "BINARY"), samples(counts(), "BINARY"))
    study = study_with(path)
    replay = build_timeline(study).replay
    assert replay is not None
    t_s = replay.spec.origin + np.arange(2000) * 50e-6
    exact = sum(voltage(t_s, k) * np.exp(2j * np.pi * k / 3.0) for k in range(3)) * 2.0 / 3.0
    assert np.max(np.abs(replay.vectors(0, 2000) - exact)) < 1e-4 * V + 0.1
    assert study.input_files[-2:] == (str(path), str(tmp_path / "event.dat"))


@pytest.mark.parametrize("phases", ["ABC", "RST", ("L1", "L2", "L3")])
def test_the_phases_are_found_by_their_letters(tmp_path: Path, phases: tuple[str, ...]) -> None:
    """In the order a, b, c, beside a voltage of the other side of the breaker."""
    order = [2, 0, 1]
    described = [channel(1, "sync", ph="")]
    described += [channel(k + 2, f"u{phase}", ph=phases[phase], uu="V", a=0.05) for k, phase in enumerate(order)]
    columns = np.column_stack([counts()[:, 3], counts()[:, order]])
    path = write(tmp_path, config(described, COUNT, "BINARY"), samples(columns, "BINARY"))
    np.testing.assert_allclose(read_record(str(path), None, None).values, 0.05 * counts()[:, :3], rtol=1e-13)
    twice = [*described, channel(5, "other", ph=phases[0])]
    path = write(tmp_path, config(twice, COUNT, "BINARY"), samples(np.tile(columns, 2)[:, :5], "BINARY"))
    assert "the file has 5 voltages (sync, u2, u0, u1, other), not one or three phases" in faults(path)


def test_times_take_the_place_of_a_rate(tmp_path: Path) -> None:
    path = write(tmp_path, config(lines(), COUNT, "BINARY", rates=[f"0,{COUNT}"]), samples(counts(), "BINARY"))
    assert read_record(str(path), PHASES, None).rate == pytest.approx(RATE, rel=1e-12)


def test_several_rates_are_refused_by_name(tmp_path: Path) -> None:
    cfg = config(lines(), COUNT, "BINARY", rates=["4000,500", f"1000,{COUNT}"])
    text = faults(write(tmp_path, cfg, samples(counts(), "BINARY")))
    assert "several sampling rates: 4000 Hz (samples 1 to 500), 1000 Hz (samples 501 to 2000)" in text
    assert "Export the part that you need at one rate." in text
    equal = config(lines(), COUNT, "BINARY", rates=["4000,500", f"4000,{COUNT}"])
    assert read_record(str(write(tmp_path, equal, samples(counts(), "BINARY"))), None, None).rate == RATE


def test_what_is_no_voltage_of_a_phase_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, config(lines(), COUNT, "BINARY"), samples(counts(), "BINARY"))
    assert 'columns: "ia" is in "A", which is no unit of a voltage' in faults(path, ("va", "vb", "ia"))
    assert 'columns: there is no column "vd". The file has va, vb, vc, ia.' in faults(path, ("va", "vb", "vd"))
    assert "sampling_rate: the file says 4000 Hz" in faults(path, None, 5000.0)
    path = write(tmp_path, config(lines()[1:], COUNT, "BINARY"), samples(counts()[:, 1:], "BINARY"))
    assert "the file has 2 voltages (vb, vc), not one or three phases. Choose." in faults(path)
    between = [channel(k + 1, name, ph=name) for k, name in enumerate(("AB", "B-C", "Ca"))]
    path = write(tmp_path, config(between, COUNT, "BINARY"), samples(counts()[:, :3], "BINARY"))
    assert faults(path).count("is between two phases") == 3
    both = [*lines()[:3], *(channel(k, name, ph=name) for k, name in enumerate(("AB", "BC", "CA"), start=4))]
    path = write(tmp_path, config(both, COUNT, "BINARY"), samples(np.tile(counts()[:, :3], 2), "BINARY"))
    np.testing.assert_allclose(read_record(str(path), None, None).values, 0.05 * counts()[:, :3], rtol=1e-13)
    skewed = [channel(k + 1, name, skew=50 * k) for k, name in enumerate(PHASES)]
    path = write(tmp_path, config(skewed, COUNT, "BINARY"), samples(counts()[:, :3], "BINARY"))
    assert "its voltages are sampled up to 100 us apart" in faults(path)


@pytest.mark.parametrize(("form", "missing"), [("ASCII", 99999), ("BINARY", -32768), ("FLOAT32", np.nan)])
def test_missing_samples_are_counted(tmp_path: Path, form: str, missing: float) -> None:
    holed = counts().astype(float if form == "FLOAT32" else int)
    holed[700:720, 1] = missing
    path = write(tmp_path, config(lines(), COUNT, form, "2013"), samples(holed, form))
    assert "20 of 2000 samples are missing or no numbers (the first is sample 701)" in faults(path)


def test_records_that_are_cut_or_none(tmp_path: Path) -> None:
    cfg, dat = config(lines(), COUNT, "BINARY"), samples(counts(), "BINARY")
    assert "its samples have 31999 bytes, and each has 16" in faults(write(tmp_path, cfg, dat[:-1]))
    assert "its .cfg says 2000 samples, and its .dat has 1999" in faults(write(tmp_path, cfg, dat[:-16]))
    gap = samples(counts(1000), "BINARY") + samples(counts(1000), "BINARY", first=1004)
    assert "samples are missing: number 1004 follows number 1000" in faults(write(tmp_path, cfg, gap))
    for old, new, says in (
        ("4,4A", "4,xA", 'line 2 of its .cfg: "x" is not a number of analog channels'),
        ("4,4A", "9,9A", "line 7 of its .cfg: a line with an analog channel has 10 fields or more, and this one has 1"),
        ("5e-05", "zero", 'line 3 of its .cfg: "zero" is not a number (a)'),
        ("5e-05", "0", "line 3 of its .cfg: a = 0, b = 0 scale no channel"),
        ("BINARY", "PCM", 'line 12 of its .cfg: "PCM" is no form of samples: ASCII, BINARY'),
        ("01/02/2024", "", "cannot be read as COMTRADE"),
    ):
        changed = cfg[: cfg.index(old)] if not new else cfg.replace(old, new)
        assert says in faults(write(tmp_path, changed, dat)), says
    wrong = samples(counts(), "ASCII").replace(b"\r\n", b";\r\n", 1)
    text = faults(write(tmp_path, config(lines(), COUNT, "ASCII"), wrong))
    assert "row 1 of its .dat is not 6 numbers" in text
    (tmp_path / "event.dat").unlink()
    assert 'there is no "event.dat" beside it, which has its samples. Put both files' in said(
        file=str(tmp_path / "event.cfg")
    )
    assert "cannot be read: No such file" in said(file=str(tmp_path / "none.cfg"))
    (tmp_path / "event.cff").write_bytes(b"--- file type: CFG ---\r\n" + cfg.encode())
    assert 'its part "--- file type: DAT ---" is missing' in faults(tmp_path / "event.cff")
    (tmp_path / "event.cdf").write_bytes(dat)
    assert '".cdf" is no format of a record. Known: .csv, .txt, .wav, .npz, .cfg, .dat' in faults(
        tmp_path / "event.cdf"
    )
