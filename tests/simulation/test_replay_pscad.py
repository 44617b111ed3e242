"""The text output of PSCAD as a recorded source: files that are written here after its layout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.simulation.test_replay import V, study_with, voltage
from vsgdesign.simulation import build_timeline
from vsgdesign.study.parameters.record import read_record, record_files
from vsgdesign.study.parameters.record_columns import RecordError

RATE = 10_000
COUNT = 5000


def run(folder: Path, title: str = "Bench", *, names: bool = True) -> Path:
    """Twelve channels: P, eight angles, and the voltages in kV as channels 10 to 12. Returns the .inf."""
    t_s = np.arange(COUNT) / RATE
    columns = [np.full(COUNT, 1.5), *(0.1 * k + t_s for k in range(8)), *(1e-3 * voltage(t_s, k) for k in range(3))]
    for number, part in (("01", columns[:10]), ("02", columns[10:])):
        rows = np.column_stack([t_s, *part])
        np.savetxt(folder / f"case_{number}.out", rows, fmt="%.12g", header=title, comments="")
    entries = [("P", "Main", "MW"), *((f"angle:{k}", "Main", "rad") for k in range(8))]
    entries += [(f"Vpcc:{k + 1}", "Grid", "kV") for k in range(3)]
    lines = [
        f'PGB({k + 1}) Output Desc="{name}" Group="{group}" Max=2.0 Min=-2.0 Units="{unit}"'
        for k, (name, group, unit) in enumerate(entries)
    ]
    if names:
        (folder / "case.inf").write_text("\n".join(reversed(lines)) + "\n")
    return folder / "case.inf"


def faults(path: Path, columns: tuple[str, ...] | None = None) -> str:
    with pytest.raises(RecordError) as error:
        read_record(str(path), columns, None)
    return "\n".join(f"{field}: {problem}. {advice}" for field, problem, advice in error.value.faults)


@pytest.mark.parametrize("title", ["", "Bench", "0 1 2 3 4 5 6 7 8 9 ten"])
def test_a_run_of_several_files_is_played(tmp_path: Path, title: str) -> None:
    path = run(tmp_path, title)
    record = read_record(str(path), None, None)
    assert record.rate == pytest.approx(RATE, rel=1e-9)
    t_s = np.arange(COUNT) / RATE
    exact = np.stack([voltage(t_s, k) for k in range(3)], axis=1)
    np.testing.assert_allclose(record.values, exact, rtol=0.0, atol=1e-9 * V)
    named = read_record(str(path), ("Vpcc:1", "11", "Vpcc:3"), None)
    assert np.array_equal(named.values, record.values)
    assert [Path(one).name for one in record_files(str(path))] == ["case.inf", "case_01.out", "case_02.out"]
    replay = build_timeline(study_with(path)).replay
    assert replay is not None
    assert replay.spec.V_g_rms == pytest.approx(V / np.sqrt(2.0), rel=1e-4)


def test_one_file_alone(tmp_path: Path) -> None:
    """Its own channels, by name where the .inf is there, by number where it is not."""
    t_s = np.arange(COUNT) / RATE
    run(tmp_path)
    assert "the file has 2 voltages (Vpcc:2, Vpcc:3), not one or three" in faults(tmp_path / "case_02.out")
    found = read_record(str(tmp_path / "case_02.out"), ("Vpcc:3",), None)
    np.testing.assert_allclose(found.values[:, 0], voltage(t_s, 2), atol=1e-9 * V)
    (tmp_path / "case.inf").unlink()
    found = read_record(str(tmp_path / "case_02.out"), ("12",), None)
    np.testing.assert_allclose(found.values[:, 0], 1e-3 * voltage(t_s, 2), atol=1e-12 * V)


def test_what_is_wrong_with_a_run(tmp_path: Path) -> None:
    path = run(tmp_path)
    assert 'columns: "P" is in "MW", which is no unit of a voltage' in faults(path, ("P",))
    assert 'columns: there is no column "Vpcc". The file has P, angle:0' in faults(path, ("Vpcc",))
    text = (tmp_path / "case_02.out").read_text().splitlines()
    (tmp_path / "case_02.out").write_text("\n".join(text[:-1]) + "\n")
    assert '"case_02.out" has other times than "case_01.out". Take the files of one run.' in faults(path)
    (tmp_path / "case_02.out").write_text("\n".join([*text[:40], "0.004 one 2", *text[41:]]) + "\n")
    assert '"case_02.out" cannot be read as numbers in columns: line 41' in faults(path)
    (tmp_path / "case_02.out").write_text("\n".join([*text[:40], text[40].replace(text[40].split()[1], "NaN")]) + "\n")
    assert "1 of 40 samples are missing or no numbers (the first is sample 40)" in faults(
        tmp_path / "case_02.out", ("Vpcc:2",)
    )
    (tmp_path / "case_02.out").unlink()
    text_of = faults(path)
    assert 'the channel "Vpcc:2" of its .inf is missing in its .out files. Put "case_02.out" beside it' in text_of
    (tmp_path / "case_01.out").unlink()
    assert 'there is no "case_01.out" beside it, which has its samples' in faults(path)
    run(tmp_path)
    path.write_text("station, 1999\n")
    assert '"case.inf" has no line that begins with PGB(1). Give the .inf of PSCAD. Of a COMTRADE' in faults(path)
    (tmp_path / "case_01.out").write_text("title\n")
    (tmp_path / "case.inf").unlink()
    assert '"case_01.out" has fewer than two rows of a time and a channel' in faults(tmp_path / "case_01.out")


def test_equal_names_of_two_groups_are_told_apart(tmp_path: Path) -> None:
    t_s = np.arange(COUNT) / RATE
    np.savetxt(tmp_path / "twin_01.out", np.column_stack([t_s, voltage(t_s), 2.0 * voltage(t_s)]), header="")
    (tmp_path / "twin.inf").write_text(
        'PGB(1) Output Desc="V" Group="A" Units="V"\nPGB(2) Output Desc="V" Group="B" Units="V"\n'
    )
    found = read_record(str(tmp_path / "twin.inf"), ("B/V",), None)
    np.testing.assert_allclose(found.values[:, 0], 2.0 * voltage(t_s), atol=1e-9 * V)
