"""table build: the file, what is said of it, faults, Ctrl-C, and kill -9 at any moment."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result

from evidence._table_mutations import TABLE
from evidence.table_mutations import checked, outcomes
from tests.cli.small_studies import SMALL, as_json, call, failure
from tests.design.robust_studies import ROOT, TEXT
from vsgdesign import certificate
from vsgdesign.artifacts import read_table_file, write_table_file
from vsgdesign.artifacts.certificate_record import certificate_record
from vsgdesign.artifacts.gain_table_file import TABLE_FILE
from vsgdesign.certificate import Region
from vsgdesign.design import table as building
from vsgdesign.design.record import cells_file
from vsgdesign.design.table import BuiltTable, build_table
from vsgdesign.execution.journal import kept_count, kept_folder
from vsgdesign.linear.stability.safe_place import table_safe_place
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.verbs.pipeline.study_tables import CELLS
from vsgdesign.verbs.pipeline.table import check_whole_table

POINTS = "40"
COMMAND = [sys.executable, "-m", "vsgdesign.verbs.cli.program", "table", "build"]


@pytest.fixture(scope="module")
def study_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With an exact estimate, two active powers and no reactive one: few scenarios, and a cell is done in no time."""
    text = TEXT
    for wide, few in (
        ("error = 0.2", "error = 0.0"),
        ("P = [-4500, 4500]", "P = [0, 4500]"),
        ("Q = [-2000, 2000]", "Q = [0]"),
        ('"studies/', f'"{ROOT.as_posix()}/studies/'),
    ):
        assert wide in text
        text = text.replace(wide, few)
    path = tmp_path_factory.mktemp("study") / "robust.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def built(study_file: Path) -> tuple[Path, BuiltTable]:
    """The table of an undisturbed build in this process, as a file and as it was handed over."""
    out, found = study_file.parent / "table.json", []

    def watched(*args: Any, **kwargs: Any) -> BuiltTable:
        found.append(build_table(*args, **kwargs))
        return found[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(building, "build_table", watched)
        shown = call("table", "build", study_file, "--out", out, "--workers", "1", "--points", POINTS)
    assert shown.exit_code == 0, shown.output
    assert "2 SCR × 2 X/R: 4 met, 0 relaxed, 0 outside" in shown.stdout
    assert f"{POINTS} random grids, 0 outside the static limits, {POINTS} promised, 0 broken" in shown.stdout
    assert sorted(path.name for path in study_file.parent.iterdir()) == ["robust.toml", "table.json"]
    return out, found[0]


@pytest.fixture
def undisturbed(built: tuple[Path, BuiltTable]) -> Path:
    return built[0]


def test_the_table_is_what_it_says(undisturbed: Path, study_file: Path) -> None:
    table = read_table_file(undisturbed)
    assert (table.name, table.structure, table.law) == ("angle_damped", "angle_damped", "poles")
    found = check_whole_table(table, load_study(study_file))
    assert found.faults == ()
    assert {"worst_settling_P_s", "price", "active", "between", "safe_place"} <= set(found.carried)
    assert table.specification["settling_time"] == 1.3
    assert table.margins["worst_disk_margin_output"].min() >= 1.0
    for own in "PQ":
        assert table.margins[f"worst_overshoot_{own}_pct"].max() <= 5.0
        assert table.margins[f"worst_settling_{own}_s"].max() <= 1.3
    assert np.isfinite(table.gains.K_ip).all()
    assert table.safe_place is not None
    assert table.safe_place == table_safe_place(load_study(study_file), table)


def test_without_a_certificate_the_table_is_the_same(
    built: tuple[Path, BuiltTable], study_file: Path, tmp_path: Path
) -> None:
    study, table = load_study(study_file), built[1].table
    plain = build_table(study, study.controllers[-1], tmp_path, points=int(POINTS), certificate=False).table
    assert plain.certificate is None
    assert table.certificate is not None
    write_table_file(plain, tmp_path / "plain.json")
    write_table_file(replace(table, certificate=None), tmp_path / "other.json")
    assert (tmp_path / "plain.json").read_bytes() == (tmp_path / "other.json").read_bytes()


def wait_for_cells(process: subprocess.Popen[Any], out: Path, count: int) -> None:
    """Until so many cells are finished, and the folder for them is there: an event, however busy the machine is."""
    end = time.monotonic() + 120.0
    while process.poll() is None and time.monotonic() < end:
        if kept_folder(out, CELLS).is_dir() and kept_count(out, CELLS) >= count:
            return
        time.sleep(0.03)
    pytest.fail(f"the build ended before {count} cells were finished, with {process.poll()}")


def test_killed_at_any_moment_it_ends_with_the_same_bytes(undisturbed: Path, study_file: Path, tmp_path: Path) -> None:
    """kill -9 while it starts, designs and checks; then a last call. Workers hold the pipes: they end when killed."""
    out = tmp_path / "table.json"
    command = [*COMMAND, str(study_file), "--out", str(out), "--workers", "2", "--points", POINTS]
    for finished in (0, 1, 4):
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        wait_for_cells(process, out, finished)
        process.kill()
        process.communicate(timeout=90.0)
        assert not out.exists()
    with cells_file(kept_folder(out, CELLS)).open("ab") as journal:
        journal.write(b'{"half')
    done = subprocess.run(command, capture_output=True, text=True, timeout=120.0)
    assert (done.returncode, done.stderr) == (0, "")
    assert out.read_bytes() == undisturbed.read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["table.json"]


@pytest.mark.parametrize(
    ("number", "code", "word", "whole"),
    [
        (signal.SIGINT, 130, "interrupted", True),
        (signal.SIGTERM, 143, "terminated", False),
        (signal.SIGTERM, 143, "terminated", True),
        (signal.SIGHUP, 129, "hung up", True),
    ],
)
def test_interruption_keeps_finished_cells(
    number: int, code: int, word: str, whole: bool, study_file: Path, tmp_path: Path
) -> None:
    """To the ``whole`` group, as Ctrl-C goes from a terminal, or to the first process: one line, no worker's traceback.

    Workers hold the pipes: the call returns when they have ended.
    """
    out = tmp_path / "table.json"
    command = [*COMMAND, str(study_file), "--out", str(out), "--workers", "2", "--points", POINTS]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    wait_for_cells(process, out, 1)
    (os.killpg if whole else os.kill)(process.pid, number)
    stdout, stderr = process.communicate(timeout=90.0)
    kept = kept_count(out, CELLS)
    assert (process.returncode, stdout) == (code, "")
    cells = "1 finished cell is" if kept == 1 else f"{kept} finished cells are"
    assert stderr == f"{word}: {cells} kept; the same command continues there\n"
    assert kept >= 1
    assert not out.exists()


def test_as_json_and_over_a_table_of_before(
    built: tuple[Path, BuiltTable], study_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A node that is given up and a promise broken between nodes are said, with what would do."""
    undisturbed, whole = built
    first = whole.records[0]
    assert first.design is not None
    missed = replace(first.design, shortfalls={"overshoot": 0.07, "settling_time": float("inf")})
    unstable = replace(first.design, shortfalls={"inner_loops": 320.0})
    bad = replace(whole.between.points[0], promised=True, missed={"disk_margin": 0.9})
    fake = replace(
        whole,
        added=(("scr", 4.24264),),
        records=(replace(first, design=missed), replace(first, design=unstable, inner_rad_s=320.0), *whole.records[2:]),
        between=replace(whole.between, points=(bad, *whole.between.points[1:])),
    )
    monkeypatch.setattr(
        building, "build_table", lambda *_, **__: (kept_folder(undisturbed, CELLS).mkdir(exist_ok=True), fake)[1]
    )
    before = undisturbed.read_bytes()
    document = as_json("table", "build", study_file, "--out", undisturbed, "--workers", "1")
    assert undisturbed.read_bytes() == before
    assert document["added"] == [{"axis": "scr", "value": 4.24264}]
    assert document["relaxed"][0]["would_be_feasible_with"] == {"overshoot": 0.07, "settling_time": None}
    assert document["between"]["broken"][0]["reached"] == {"disk_margin": 0.9}
    shown = call("table", "build", study_file, "--out", undisturbed, "--workers", "1").stdout
    for part in (
        "nodes added between: scr 4.24264",
        "not as specified; feasible with overshoot 0.07, settling time ∞",
        "the inner loops or the filter are unstable at 320 rad/s",
        f"{POINTS} promised, 1 broken",
        "breaks its promise with disk margin at the output 0.9",
    ):
        assert part in shown, part


def test_fresh_does_not_look_at_old_cells(study_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "table.json"
    kept_folder(out, CELLS).mkdir()
    old = cells_file(kept_folder(out, CELLS))
    old.write_text(f"{hashlib.sha256(b'{}').hexdigest()[:32]} 1 {{}}\n")

    def look(*_: object, **__: object) -> None:
        assert old.exists() is not fresh
        raise KeyboardInterrupt

    monkeypatch.setattr(building, "build_table", look)
    for fresh, said in ((False, "1 finished cell is kept"), (True, "nothing was written")):
        assert said in failure(130, "table", "build", study_file, "--out", out, "--workers", "1", *["--fresh"] * fresh)


def test_the_second_of_two_builds_says_that_another_is_at_work(
    built: tuple[Path, BuiltTable], study_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also through a link to the table; and the first ends as if it had been alone."""
    out = tmp_path / "table.json"
    (tmp_path / "link.json").symlink_to(out)
    command = ("table", "build", study_file, "--workers", "1", "--out")

    def during(_study: object, _controller: object, folder: Path, **_: object) -> BuiltTable:
        cells_file(folder).write_text("{}")
        for also in (out, tmp_path / "link.json"):
            for fresh in ([], ["--fresh"]):
                message = failure(2, *command, also, *fresh)
                assert "is being made by another process" in message
                assert message.count("\n") == 1
        assert cells_file(folder).exists()
        return built[1]

    monkeypatch.setattr(building, "build_table", during)
    assert call(*command, out).exit_code == 0
    assert out.read_bytes() == built[0].read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.json", "table.json"]


def test_faults_are_told_before_the_work(study_file: Path, tmp_path: Path) -> None:
    plain = tmp_path / "plain.toml"
    plain.write_text(SMALL, encoding="utf-8")
    foreign = tmp_path / "foreign.json"
    foreign.write_text(json.dumps({"mine": 1}))
    out = ("--out", tmp_path / "t.json")
    for code, says, arguments in (
        (2, "specification: missing table", (plain, *out)),
        (
            2,
            'controller = "nobody": unknown. The study has: published, decoupled, angle_damped',
            (study_file, "--controller", "nobody", *out),
        ),
        (2, "is not a folder", (study_file, "--out", foreign / "t.json")),
        (2, "it is a device or a pipe", (study_file, "--out", "/dev/full")),
        (2, "it is a folder", (study_file, "--out", tmp_path)),
        (2, "is not a gain table as it was written, and is left untouched", (study_file, "--out", foreign)),
        (1, "no scheduler answers", (study_file, *out, "--cluster", "nonsense://x")),
        (2, "a cluster at an address has its own", (study_file, *out, "--cluster", "x:1", "--workers", "2")),
    ):
        assert says in failure(code, "table", "build", *arguments), says
    assert sorted(path.name for path in tmp_path.iterdir()) == ["foreign.json", "plain.toml"]


@pytest.fixture(scope="module")
def verified(
    built: tuple[Path, BuiltTable], study_file: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Result]:
    """The same table, verified in 24 cases, and what was printed of it."""
    out = tmp_path_factory.mktemp("verified") / "table.json"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(building, "build_table", lambda *_, **__: built[1])
        return out, call("table", "build", study_file, "--out", out, "--workers", "1", "--verify", "24")


def test_a_table_that_is_verified_says_so(built: tuple[Path, BuiltTable], verified: tuple[Path, Result]) -> None:
    out, shown = verified
    assert shown.exit_code == 0, shown.output
    table, plain = read_table_file(out), read_table_file(built[0])
    assert plain.verification is None
    assert table.verification is not None
    assert (table.verification["runs"], table.verification["judged"] <= 24) == (24, True)
    assert replace(table, verification=None) == plain
    assert "Verified in EMT" in shown.stdout
    step = table.verification["families"]["step"]["promises"]["settling"]
    assert f"{step['broken']} of {step['judged']} steps above 1.3 s" in shown.stdout
    assert "Verified in EMT" in call("table", "show", out).stdout
    assert [path.name for path in out.parent.iterdir()] == ["table.json"]


def test_changed_tables_with_right_hashes_are_refused_or_not_called_good(
    verified: tuple[Path, Result], tmp_path: Path
) -> None:
    """Each kind of change once; two hundred in evidence/table_mutations.py."""
    document, changed = json.loads(verified[0].read_text(encoding="utf-8")), tmp_path / "changed.json"
    found = outcomes(document, TABLE, len(TABLE), 2031, TABLE_FILE, lambda t, m, f: checked(changed, t, m, f))
    assert [(one.kind, one.field, one.says) for one in found if not one.right] == []
    assert {one.refused for one in found} == {True, False}


def test_the_certificate_of_a_table_is_that_of_certify(
    verified: tuple[Path, Result], study_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A study may give SCR on another basis than the table: the region is the table's, steps included."""
    asked: dict[str, Any] = {}

    def search(study: Study, _spec: object, region: Region, **_: object) -> None:
        asked.update(basis=study.scr_basis, region=region)
        raise KeyboardInterrupt

    monkeypatch.setattr(certificate, "certify", search)
    (tmp_path / "uses.toml").write_text(
        f'base = "{study_file}"\n[[controllers]]\nname = "angle_damped"\nkind = "scheduled"\nschedule = "table"\n'
        f'structure = "angle_damped"\ntable = "{verified[0]}"\n'
    )
    assert load_study(tmp_path / "uses.toml").scr_basis == "reactance"
    call("certify", tmp_path / "uses.toml")
    table = read_table_file(verified[0])
    assert table.certificate is not None
    assert asked["basis"] == table.base.scr_basis == "impedance"
    found = certificate_record({"region": asked["region"].as_document()}).region
    assert replace(found, limits=table.certificate.region.limits) == table.certificate.region
