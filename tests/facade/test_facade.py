"""``import vsgdesign as vd``: the same answers as the rooms and the verbs give, in few lines."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vsgdesign as vd
from tests.cli.small_studies import as_json
from tests.gain_tables import table as gain_table
from vsgdesign.artifacts import write_table_file
from vsgdesign.artifacts.design_inputs import design_inputs
from vsgdesign.artifacts.gain_table import base_of
from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import ArtifactError, StudyError
from vsgdesign.verbs.facade import exports
from vsgdesign.verbs.pipeline import study_tables

ROOT = Path(__file__).resolve().parents[2]
STUDY = """
base = "case:hoang2025_5kva"
[simulation]
duration = "0.3 s"
P_ref = "2 kW"
Q_ref = 0
[[controllers]]
name = "AVSG"
kind = "scheduled"
[[events]]
time = "0.1 s"
P_ref = "2.5 kW"
"""
SPECIFICATION = {
    "scr_basis": "impedance",
    "settling_time": "1.3 s",
    "overshoot": 0.05,
    "disk_margin": 1.0,
    "P": [4500],
    "Q": [1000],
    "error": 0.0,
    "scr": [3, 4],
    "x_over_r": [2, 3],
}


@pytest.fixture(scope="module")
def study() -> vd.Study:
    return vd.load(
        "case:hoang2025_5kva",
        P_ref="2 kW",
        duration="0.3 s",
        controllers=[vd.controller("AVSG")],
        events=[vd.event("0.1 s", P_ref="2.5 kW")],
    )


@pytest.fixture(scope="module")
def run(study: vd.Study) -> vd.Run:
    return vd.simulate(study)


def test_every_public_name_is_there_and_typed() -> None:
    stub = ast.parse((ROOT / "vsgdesign" / "__init__.pyi").read_text(encoding="utf-8"))
    typed = {alias.asname for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert typed | {"__version__"} == set(vd.__all__) == set(dir(vd))
    for name in vd.__all__:
        assert getattr(vd, name) is not None
    with pytest.raises(AttributeError, match="simulat"):
        _ = vd.simulat  # pyright: ignore[reportAttributeAccessIssue]


def test_the_schedulers_loader_needs_numpy_alone() -> None:
    code = (
        "import sys, vsgdesign as vd; vd.load_scheduler; "
        "print(sorted(set(sys.modules) & {'casadi', 'scipy', 'numba', 'matplotlib', 'torch', 'click', 'control'}))"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_a_study_in_python_is_the_study_of_the_file(study: vd.Study, tmp_path: Path) -> None:
    file = tmp_path / "hoang2025_5kva.toml"
    file.write_text(STUDY, encoding="utf-8")
    read = vd.load(file)
    assert (read.controllers, read.events, read.simulation) == (study.controllers, study.events, study.simulation)
    assert vd.load(file, P_ref="1 kW").simulation.P_ref == 1000.0
    assert vd.load(file, P_ref="1 kW").files == read.files
    document: dict[str, Any] = {"base": "case:hoang2025_5kva", "simulation": {"P_ref": np.float64(2e3)}}
    assert vd.load(document, duration=0.3).simulation.duration == 0.3


def test_faults_are_the_readers_all_at_once() -> None:
    with pytest.raises(StudyError) as caught:
        vd.load("case:hoang2025_5kva", grid=vd.grid(scr=-1, x_over_r=3), P_ref="2 kV", gridd={})  # pyright: ignore[reportCallIssue]
    assert {"grid.scr", "simulation.P_ref", "gridd"} <= {fault.field for fault in caught.value.faults}
    with pytest.raises(StudyError, match="no such case"):
        vd.load("case:nothing")
    with pytest.raises(StudyError, match="no such file"):
        vd.load("nothing.toml", P_ref=1.0)


def test_a_run_says_what_the_verb_says(run: vd.Run, tmp_path: Path) -> None:
    file = tmp_path / "hoang2025_5kva.toml"
    file.write_text(STUDY, encoding="utf-8")
    printed = as_json("simulate", file, "--out", tmp_path / "out")
    ours = json.loads(json.dumps(run.to_dict(), allow_nan=False))
    for key in ("gains", "operating_points", "promises", "warnings"):
        assert ours[key] == printed[key], key
    (name,) = printed["controllers"]
    assert ours["controllers"][name]["events"] == printed["controllers"][name]["events"]
    assert run.events()[0].cycle_mean.overshoot_pct == printed["controllers"][name]["events"][0]["overshoot_pct"]
    assert run.series()["P_pcc"].shape == run.series("AVSG")["t_s"].shape
    with pytest.raises(KeyError, match="AVSG"):
        run.controller("CVSG")


def test_a_run_draws_and_shows_itself(run: vd.Run, tmp_path: Path) -> None:
    picture = tmp_path / "step.png"
    figure = run.plot(file=picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert figure.get_axes()[0].get_ylabel().startswith("Active power")
    run.plot("voltage", file=picture)  # our own picture is replaced
    for suffix in (".svg", ".pdf"):
        run.plot(file=picture.with_suffix(suffix))
        run.plot("voltage", file=picture.with_suffix(suffix))
    html = run._repr_html_()
    assert html.startswith("<h4>")
    assert "<svg" in html
    assert str(run).startswith(run.title)
    with pytest.raises(KeyError, match="Did you mean voltage"):
        run.plot("voltag")


def test_a_picture_never_replaces_something_else(run: vd.Run, tmp_path: Path) -> None:
    work = tmp_path / "work.png"
    for own in (b"mine", b"\x89PNG\r\n\x1a\n a photograph"):
        work.write_bytes(own)
        with pytest.raises(ArtifactError, match="left unchanged"):
            run.plot(file=work)
        assert work.read_bytes() == own
    for name in ("step.txt", "there/step.png"):
        with pytest.raises(ArtifactError):
            run.plot(file=tmp_path / name)
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(ArtifactError, match="folder"):
        run.plot(file=tmp_path / "folder.png")


def test_reports_are_those_of_the_verbs(run: vd.Run, tmp_path: Path) -> None:
    found = vd.write_report(run, tmp_path / "run", explorer=False)
    assert found["controllers"]["AVSG"]["events"] == run.to_dict()["controllers"]["AVSG"]["events"]
    assert (tmp_path / "run" / "report.html").is_file()
    (tmp_path / "run" / "mine.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(ArtifactError):
        vd.write_report(run, tmp_path / "run")


def test_a_page_is_that_of_the_verb(study: vd.Study, tmp_path: Path) -> None:
    page = vd.explore(study, tmp_path / "page.html", controllers=["AVSG"], scr=4.0, lattice=(2, 1), ready=Ready())
    text = page.read_text(encoding="utf-8")
    kept, _ = json.JSONDecoder().raw_decode(text, text.index("window.STATIC = ") + len("window.STATIC = "))
    assert kept["info"]["defaults"]["scr"] == 4.0
    assert [one["name"] for one in kept["info"]["controllers"]] == ["AVSG"]
    with pytest.raises(vd.VsgDesignError, match="2 to 120 of SCR"):
        vd.explore(study, page, lattice=(1, 1), ready=Ready())
    with pytest.raises(vd.VsgDesignError, match="BVSG"):
        vd.explore(study, page, controllers=["BVSG"], lattice=(2, 1), ready=Ready())
    with pytest.raises(TypeError, match="explore takes a study"):
        vd.explore(3, page)  # type: ignore[arg-type]


def test_margins_are_those_of_the_verb(study: vd.Study) -> None:
    axes = {"scr": [2, 8], "x_over_r": [1, 3], "P": ["4.5 kW"], "Q": ["1 kvar"]}
    small = study.with_changes(stability=axes)
    margins = vd.margins(small)
    assert margins.result.evidence == {}
    document = margins.to_dict()
    assert set(document["controllers"]) == {"AVSG"}
    assert margins.sentences()
    assert margins.pictures


def test_a_table_from_specification_to_scheduler(study: vd.Study, tmp_path: Path) -> None:
    asked = study.with_changes(
        specification=SPECIFICATION,
        controllers=[vd.controller("table", structure="angle_damped", schedule="table")],
        grid={"scr_basis": "impedance"},
    )
    table = vd.design_table(asked, workers=1, points=5)
    assert table.table.scr.tolist() == [3.0, 4.0]
    file = table.save(tmp_path / "table.json")
    assert vd.open_table(file).table == table.table
    proof = vd.certify(asked, table=table, decay=1.0)
    assert proof
    assert proof.to_dict()["decay"] == 1.0
    assert "1" in proof.sentences()[0]
    exported = vd.export_c(table, tmp_path / "c")
    assert exported.manifest["table"]["sha256"] == table.table.sha256
    scheduler = vd.load_scheduler(file)
    Z = asked.converter.Z_base / 3.5
    assert scheduler.update_estimate(Z * 0.4, Z * 0.9 / asked.converter.omega_n, 4e3, 0.0, 110.0, 0).gains.K_ip > 0.0


ONE_CELL: dict[str, Any] = {"scr": (3.0, 3.0), "x_over_r": (2.0, 2.0), "P_pu": (0.5, 0.5), "Q_pu": (0.0, 0.0)}
"""And an exact estimate: a region that is proved at once. How large it is does not matter to where a table is found."""


@pytest.mark.parametrize(
    "take",
    [vd.simulate, vd.margins, partial(vd.certify, **ONE_CELL, error=0.0, decay=0.1)],
    ids=["simulate", "margins", "certify"],
)
def test_tables_are_found_where_the_verbs_find_them(take: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each call designed the table again, and took none of the tables that the verbs take."""
    asked = vd.load(
        "case:hoang2025_5kva",
        P_ref="2 kW",
        duration="0.1 s",
        controllers=[vd.controller("AVSG", schedule="table")],
        specification=SPECIFICATION,
        stability={"scr": [3, 4], "x_over_r": [2, 3]},
    )
    spec = asked.controllers[0]
    kept = replace(
        gain_table(name="AVSG", base=base_of(asked, "impedance")),
        study=asked.name,
        design_inputs=design_inputs(asked, spec.target),
        safe_place=(3.0, 3.0),
    )
    (tmp_path / "out" / asked.name).mkdir(parents=True)
    write_table_file(kept, tmp_path / "out" / asked.name / "AVSG.table.json")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(study_tables, "_designed", lambda *_: pytest.fail("it was designed again"))
    assert take(asked).to_dict()


def test_a_table_of_a_plant_is_designed_once_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each linear model and each export of a plant's study designed the same table again, for minutes."""
    designed = []

    def design(study: vd.Study, spec: Any, *_: Any) -> Any:
        designed.append(spec.name)
        own = gain_table(name=spec.name, base=base_of(study, "impedance"))
        return replace(own, study=study.name, design_inputs=design_inputs(study, spec.target), safe_place=(3.0, 3.0))

    monkeypatch.setattr(study_tables, "_designed", design)
    monkeypatch.chdir(tmp_path)
    changes: dict[str, Any] = {
        "specification": SPECIFICATION,
        "plant": {"units": 2, "reactance": 0.03, "resistance": 0.006},
    }
    plant = vd.load(
        "case:hoang2025_5kva", P_ref="2 kW", controllers=[vd.controller("AVSG", schedule="table")], **changes
    )
    models = [vd.linear_model(plant) for _ in range(2)]
    assert np.array_equal(models[0].A, models[1].A)
    exports.unit_given(plant, None, None)
    assert designed == ["AVSG"]
    assert (tmp_path / "out" / "hoang2025_5kva-explore" / "AVSG.table.json").is_file()


def test_a_table_that_is_opened_shows_itself(tmp_path: Path) -> None:
    shown = vd.DesignedTable(gain_table(), {})
    assert "closed form" in str(shown)
    shown.plot(file=tmp_path / "table.svg")
    assert (tmp_path / "table.svg").read_text(encoding="utf-8").startswith("<?xml")


def test_what_is_no_study_is_told() -> None:
    """A file is taken, and anything else says what is expected."""
    for function in (vd.simulate, vd.margins, vd.design_table, vd.certify):
        with pytest.raises(TypeError, match=rf"{function.__name__} takes a study, such as vd.load.*not int"):
            function(3)  # type: ignore[arg-type]
    with pytest.raises(StudyError, match="no such file"):
        vd.simulate("missing.toml")
