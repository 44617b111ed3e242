"""The page without a server: its scripts as one, its answers as those of the session."""

from __future__ import annotations

import base64
import json
import re
import zlib
from pathlib import Path

import numpy as np
import pytest

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.errors import ArtifactError
from vsgdesign.report.explore import static
from vsgdesign.report.explore.answer import Answer
from vsgdesign.report.explore.server import PAGE
from vsgdesign.report.explore.session import Session
from vsgdesign.report.explore.static import (
    BITS,
    POINTS,
    is_static_page,
    joined_modules,
    packed,
    rounded,
    static_page_of,
    write_static,
)
from vsgdesign.study.parameters import load_study, study_from_text


def _unpacked(data: bytes) -> tuple[dict, dict[str, np.ndarray]]:
    body = zlib.decompress(data)
    length = int.from_bytes(body[:4], "little")
    header = json.loads(body[4 : 4 + length])
    arrays = {
        one["name"]: np.frombuffer(body, "<f4", int(np.prod(one["shape"])), 4 + length + one["offset"]).reshape(
            one["shape"]
        )
        for one in header["arrays"]
    }
    return header, arrays


@pytest.fixture(scope="module")
def session() -> Session:
    study = load_study("studies/structures/study.toml")
    session = Session(study, NOTHING, start={"scr": 4.0, "x_over_r": 1.5, "controllers": ["decoupled"]})
    session._info = session.info() | {"figures": session.info()["figures"][1:3]}  # the quick ones are enough here
    return session


@pytest.fixture(scope="module")
def page(session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("static") / "page.html"
    assert write_static(session, path, lattices=((2, 2),)) == path.stat().st_size
    return path


def test_the_file_is_small_and_asks_for_nothing(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert len(text) < static.LIMIT_BYTES
    assert is_static_page(page)
    assert not re.search(r'<(script|link|img)[^>]*(src|href)="(?!data:)', text)
    assert text.count("</script>") == 2  # nothing inside a script ends it
    assert "'wasm-unsafe-eval'" in static.POLICY  # it compiles its loops …
    assert " 'unsafe-eval'" not in static.POLICY  # … and never runs a text


def test_its_answers_are_those_of_the_session(page: Path, session: Session) -> None:
    text = page.read_text(encoding="utf-8")
    kept = json.loads(re.search(r"window\.STATIC = (.*);</script>", text)[1])  # pyright: ignore[reportOptionalSubscript]
    lattice = kept["info"]["lattice"]
    assert kept["info"]["static"]
    assert 4.0 in lattice["scr"]  # the grid with which it begins is one of them
    assert kept["info"]["defaults"]["scr"] == 4.0
    assert lattice["hold"] == {"scr": 4.0, "x_over_r": 1.5}
    grids = [f"{i},{j}" for i in range(2) for j in range(2)]
    figures = [figure["name"] for figure in session.info()["figures"]]
    keys = [f"{kind}:{key}" for kind in ("linear", "emt") for key in grids] + [f"map:{name}" for name in figures]
    assert set(kept["answers"]) == {key + mark for key in keys for mark in ("", ",h")}
    for mark, hold in (("", None), (",h", lattice["hold"])):
        document = {
            "scr": lattice["scr"][0],
            "x_over_r": lattice["x_over_r"][1],
            "controllers": ["decoupled"],
            "hold": hold,
        }
        state = session.state(document)
        answer = session.linear(session.study_of(state), state, details=True)
        header, arrays = _unpacked(base64.b64decode(kept["answers"][f"linear:0,1{mark}"]))
        assert header["controllers"] == json.loads(json.dumps(answer.header["controllers"]))
        whole = answer.arrays["0/step_full"]
        np.testing.assert_allclose(
            [arrays["0/step_full"].min(), arrays["0/step_full"].max()], [whole.min(), whole.max()], rtol=3e-4
        )


def test_fixed_gains_are_not_held() -> None:
    """They are what they are on every grid: a second answer would be the first once more."""
    study = study_from_text(FIXED)
    text = static_page_of(study, NOTHING, ((2, 1),)).text
    assert text is not None
    kept = json.loads(re.search(r"window\.STATIC = (.*);</script>", text)[1])  # pyright: ignore[reportOptionalSubscript]
    assert len(kept["answers"]) == 2 * 2 + 6
    assert not any(key.endswith(",h") for key in kept["answers"])


def test_a_study_beyond_the_fields_of_the_page_has_none_and_says_why() -> None:
    page = static_page_of(
        study_from_text(FIXED.replace('"2 kW"', '"12 kW", reference_limit_pu = 10')), NOTHING, ((2, 1),)
    )
    assert page.text is None
    assert page.why == "P must be a number between -10 and 10 kW, not 12."


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
        write_static(session, path)
    assert path.read_text(encoding="utf-8") == "<p>mine</p>"


def test_a_page_that_becomes_too_large_is_refused(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(static, "static_text", lambda *_: "x" * (static.LIMIT_BYTES + 1))
    with pytest.raises(ArtifactError, match="MB"):
        write_static(session, tmp_path / "page.html")
    assert list(tmp_path.iterdir()) == []


def test_curves_are_thinned_and_rounded() -> None:
    t = np.linspace(0.0, 2.0, 2000)
    y = np.exp(-3.0 * t) * np.sin(40.0 * t)
    y[777] = 5.0
    answer = Answer({"x": 1 / 3}, {"0/t": t, "0/y": y, "values": np.full((20, 30), 1 / 3), "scr": np.arange(300.0)})
    header, arrays = _unpacked(packed(answer))
    assert header["x"] == 1 / 3
    assert len(arrays["0/t"]) == len(arrays["0/y"]) <= POINTS
    assert arrays["0/y"].max() == 5.0
    assert arrays["0/t"][np.argmax(arrays["0/y"])] == pytest.approx(t[777], rel=2.0**-BITS)
    assert (arrays["values"].shape, arrays["scr"].shape) == ((20, 30), (300,))


def test_rounding_keeps_what_is_not_finite() -> None:
    values = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, np.pi, -1e-30, 3.4e38])
    found = rounded(values)
    np.testing.assert_array_equal(found[:6], values[:6].astype(np.float32))
    np.testing.assert_allclose(found[6:], values[6:], rtol=2.0 ** -(BITS + 1))


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
