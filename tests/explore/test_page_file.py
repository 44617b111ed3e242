"""The page without a server: its scripts as one, its size, and which cells it has."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.errors import ArtifactError, StudyError
from vsgdesign.report.explore import page_file
from vsgdesign.report.explore.lattice import lattice_counts
from vsgdesign.report.explore.page_file import (
    OF_BRIDGE,
    bridge_shown,
    is_page,
    joined_modules,
    live_page,
    page_of_session,
    write_page,
)
from vsgdesign.report.explore.server import PAGE
from vsgdesign.report.explore.session import Session
from vsgdesign.report.page.html import POLICY
from vsgdesign.study.parameters import load_study, study_from_text


@pytest.fixture(scope="module")
def session() -> Session:
    study = load_study("studies/structures/study.toml")
    return Session(study, NOTHING, start={"scr": 4.0, "x_over_r": 1.5, "controllers": ["decoupled"]})


@pytest.fixture(scope="module")
def page(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("static") / "page.html"
    assert write_page(session, path, lattice=(3, 2)) == path.stat().st_size
    return path


def kept_of(text: str) -> dict[str, Any]:
    return json.loads(re.search(r"window\.STATIC = (.*);</script>", text)[1])  # pyright: ignore[reportOptionalSubscript]


def test_the_file_is_small_and_asks_for_nothing(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert len(text) < page_file.LIMIT_BYTES
    assert is_page(page)
    assert not re.search(r'<(script|link|img)[^>]*(src|href)="(?!data:)', text)
    assert text.count("</script>") == 2  # nothing inside a script ends it
    assert f'content="{POLICY}"' in text


def test_its_cells_are_those_of_the_lattice(page: Path) -> None:
    kept = kept_of(page.read_text(encoding="utf-8"))
    lattice = kept["info"]["lattice"]
    assert kept["info"]["static"]
    assert (len(lattice["scr"]), len(lattice["x_over_r"])) == (3, 2)
    assert 4.0 in lattice["scr"]  # the grid with which it begins is one of them
    assert kept["info"]["defaults"]["scr"] == 4.0
    assert lattice["hold"] == {"scr": 4.0, "x_over_r": 1.5}
    assert [one["name"] for one in kept["info"]["controllers"]] == ["decoupled"]
    assert [len(kept["cells"][key]) for key in ("follow", "held")] == [1, 1]
    assert kept["cells"]["columns"]["count"] == 6


def test_the_same_bytes_when_made_twice(page: Path, session: Session) -> None:
    assert page_of_session(session, (3, 2)) == page.read_text(encoding="utf-8")


def test_several_processes_make_the_same_bytes(
    page: Path, session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_file, "known_here_alone", lambda: False)
    write_page(session, tmp_path / "several.html", lattice=(3, 2), workers=2)
    assert (tmp_path / "several.html").read_bytes() == page.read_bytes()


def test_a_fine_page_is_small_enough_to_be_sent(page: Path) -> None:
    """Four controllers on 48 × 32 grids within 4 MB: measured on a part of the lattice, where neighbours are as near to
    each other, so that they are predicted as well."""
    study = load_study("studies/structures/study.toml")
    wide = Session(study, NOTHING, start={"scr": 4.0, "x_over_r": 1.5})
    ends = wide.info()["map"]
    wide._info = wide.info() | {"map": {name: [ends[name][0], ends[name][0] * (ends[name][1] / ends[name][0]) ** share]
                                        for name, share in (("scr", 7 / 47), ("x_over_r", 5 / 31))}}  # fmt: skip
    kept = kept_of(page_of_session(wide, (8, 6)))
    fixed = len(page.read_bytes())  # with six cells of one controller
    of_cells = len(kept["figures"]) + len(kept["runs"]["data"]) - 4 / 3 * kept["runs"]["info"]["module"] / 2
    assert fixed + of_cells / 48 * 4 / 3 * 48 * 32 < 4e6


def test_a_page_says_which_bridge_it_runs(session: Session, page: Path) -> None:
    """Of a study that switches, a page with an averaged bridge says so."""
    study = session.study
    own = replace(study, simulation=replace(study.simulation, bridge="pwm"))
    asked = {"averaged": study, "of a switched one": own, "pwm": own}
    for shown, one in asked.items():
        bridge = "pwm" if shown == "pwm" else "averaged"
        found = Session(one, NOTHING, bridge=bridge)
        assert (bridge_shown(found), found.study.simulation.bridge) == (shown, bridge)
    kept = kept_of(page.read_text(encoding="utf-8"))
    assert kept["info"]["made"].endswith(OF_BRIDGE["averaged"])
    assert kept["runs"]["info"]["carrier"] == {"places": [], "bodies": []}


def test_another_bridge_is_refused() -> None:
    with pytest.raises(StudyError, match=r"bridge = square.*averaged"):
        Session(load_study("studies/structures/study.toml"), NOTHING, bridge="square")


@pytest.mark.parametrize("text", ["", "48", "48x", "x32", "1x4", "121x4", "8x0", "8x81", "8.5x4", "-8x4", "8x4x2"])
def test_a_wrong_lattice_is_told(text: str) -> None:
    with pytest.raises(StudyError, match=r"2 to 120 of SCR, and 1 to 80 of X/R. Give both numbers"):
        lattice_counts(text)


def test_a_lattice_is_read() -> None:
    assert [lattice_counts(text) for text in ("48x32", " 2 X 1 ", "120×80")] == [(48, 32), (2, 1), (120, 80)]


def test_what_the_page_does_not_simulate_is_told(session: Session) -> None:
    """Its schedules know the grid at once and exactly."""
    wrong = Session(session.study, NOTHING, start={"error_R": 0.2, "silent_s": 0.5})
    with pytest.raises(StudyError, match=r"(?s)Error of R = 0.2: .*Silent after the event = 0.5: .*Set it to 0"):
        page_of_session(wrong, (2, 1))


def test_fixed_gains_are_not_held() -> None:
    """They are what they are on every grid: a second answer would be the first once more."""
    text = live_page(study_from_text(FIXED), NOTHING, (2, 1)).text
    assert text is not None
    assert "held" not in kept_of(text)["cells"]


def test_a_study_beyond_the_fields_of_the_page_has_none_and_says_why() -> None:
    page = live_page(study_from_text(FIXED.replace('"2 kW"', '"12 kW", reference_limit_pu = 10')), NOTHING, (2, 1))
    assert page.text is None
    assert page.why == "P must be a number between -10 and 10 kW, not 12."


@pytest.mark.parametrize("more", ['compensation = "none"', 'control = "voltage_droop"'])
def test_a_dc_link_that_moves_the_rest_has_none_and_says_why(more: str) -> None:
    battery = "[dc.battery]\nR_i = 0.1\ni_max = 50\ncapacity_Ah = 10\n"
    page = live_page(study_from_text(f'{FIXED}[dc]\nsource = "battery"\nC = 2e-3\n{more}\n{battery}'), NOTHING, (2, 1))
    assert page.text is None
    assert f"dc = {more}: " in page.why
    assert "Use vsgdesign explore without --page" in page.why


FIXED = """
base = "case:hoang2025_5kva"
grid = { scr = 2, x_over_r = 1 }
study = { name = "small" }
simulation = { duration = "0.3 s", P_ref = "2 kW", Q_ref = "1 kvar" }
[[controllers]]
name = "fixed"
kind = "fixed"
design_grid = { scr = 5, x_over_r = 1 }
"""


def test_another_file_is_left_untouched(session: Session, tmp_path: Path) -> None:
    path = tmp_path / "mine.html"
    path.write_text("<p>mine</p>", encoding="utf-8")
    with pytest.raises(ArtifactError, match="left untouched"):
        write_page(session, path, lattice=(2, 1))
    assert path.read_text(encoding="utf-8") == "<p>mine</p>"


def test_a_page_that_becomes_too_large_is_refused(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_file, "page_of_session", lambda *_: "x" * (page_file.LIMIT_BYTES + 1))
    with pytest.raises(ArtifactError, match="Give a coarser --lattice"):
        write_page(session, tmp_path / "page.html")
    assert list(tmp_path.iterdir()) == []


def test_scripts_are_joined_in_the_order_of_their_imports(tmp_path: Path) -> None:
    files = {
        "main.js": 'import { b as c } from "./b.js";\nimport { a } from "./a.js";\nuse(a, c);\n',
        "b.js": 'import { a } from "./a.js";\nexport function b() { return a; }\nconst own = 1;\n',
        "a.js": "export const a = 1;\nconst own = 2;\nexport class D {}\nexport async function e() {}\n",
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    joined = joined_modules(tmp_path)
    assert [joined.index(f"const module_{name}_js = ") for name in "ab"] == sorted(
        joined.index(f"const module_{name}_js = ") for name in "ab"
    )
    assert joined.count("const module_a_js = ") == 1
    assert "const { b: c } = module_b_js;" in joined
    assert "return { a, D, e };" in joined
    assert "export" not in joined


@pytest.mark.parametrize("line", ["export default 1;", 'import x from "./a.js";', 'export * from "./a.js";'])
def test_forms_of_modules_that_cannot_be_joined_are_refused(tmp_path: Path, line: str) -> None:
    (tmp_path / "main.js").write_text(line, encoding="utf-8")
    with pytest.raises(ArtifactError, match="cannot be joined"):
        joined_modules(tmp_path)


def test_the_page_can_be_joined() -> None:
    assert "class Page" in joined_modules(PAGE, "file.js")
