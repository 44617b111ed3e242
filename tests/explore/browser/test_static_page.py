"""The page without a server: one file that one opens from a disk, with the numbers of the explorer."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.explore.browser.chromium import Chromium
from tests.explore.browser.explorer import COUNTER, SETTLED, TABLE, Explorer, ExplorerPage, explorer_of


def test_a_file_alone_shows_the_numbers_of_the_explorer(
    explorer: Explorer, browser: Chromium, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from vsgdesign.report.explore import static

    info = explorer.session.info()
    monkeypatch.setattr(explorer.session, "info", lambda: {**info, "figures": info["figures"][:1]})
    path = tmp_path / "page.html"
    size = static.write_static(explorer.session, path, lattices=((3, 2),))
    assert size == path.stat().st_size <= static.LIMIT_BYTES
    page = browser.page()
    page.call("Page.addScriptToEvaluateOnNewDocument", source=COUNTER)
    page.goto(path.as_uri())
    page.wait(f"['linear', 'emt', 'map'].every((kind) => drawings[kind].length) && {SETTLED}")
    start = page.evaluate(TABLE)
    box, before = page.still("#map"), page.evaluate("drawings.linear.length")
    page.drag([box.at(across, 0.8) for across in (0.3, 0.5, 0.7, 0.9)])
    page.wait(f"drawings.linear.length > {before} && {SETTLED}")
    scr, ratio = page.evaluate("[STATIC.info.lattice.scr.at(-1), STATIC.info.lattice.x_over_r[0]]")
    assert page.evaluate("document.getElementById('where').textContent").split() == [
        "SCR", f"{scr:.2f}", "X/R", f"{ratio:.2f}",
    ]  # fmt: skip
    table = page.evaluate(TABLE)
    assert table != start
    state = explorer.state(scr=scr, x_over_r=ratio)
    stable = [one for one in explorer.header("linear", state)["controllers"] if one["stable"]]
    assert stable
    for one in stable:
        row = {name: text.replace("−", "-") for name, text in table[one["name"]].items()}
        assert row["Linear: ζ"] == f"{one['damping_all_modes']:.2f}"
        assert row["Margins: disk out"] == f"{one['disk_margin_output']:.2f}"
    assert [url for url in page.urls if url != path.as_uri() and not url.startswith(("data:", "blob:"))] == []
    assert list(page.faults) == []
    page.close()


def test_a_converter_that_nobody_tuned_for(browser: Chromium, tmp_path: Path) -> None:
    """1 MVA, 690 V, 60 Hz, an LCL filter and one sample of delay."""
    study = tmp_path / "study.toml"
    study.write_text(STUDY, encoding="utf-8")
    with explorer_of(study) as other:
        page = browser.page()
        opened = ExplorerPage(page, other.address)
        assert list(opened.table()) == ["fixed_50Hz-gains", "scheduled"]
        page.drag([opened.place(across, 0.5).point for across in (0.3, 0.5, 0.7)])
        opened.settle()
        assert other.complaints == []
        assert list(page.faults) == []
        page.close()


STUDY = """
base = "case:utility_1mva_60hz"
grid = { scr = 3, x_over_r = 6 }
simulation = { duration = "3 s", P_ref = "400 kW", Q_ref = "0 var" }

[study]
name = "unseen"

[[controllers]]
name = "fixed_50Hz-gains"
kind = "fixed"

[[controllers]]
name = "scheduled"
kind = "scheduled"
structure = "angle_damped"
"""
