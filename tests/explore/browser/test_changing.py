"""What one does: drag, click, type, hold the gains, choose an event, undo, and open a link."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from tests.explore.browser.chromium import Page
from tests.explore.browser.explorer import Explorer, ExplorerPage

ONE_PIXEL = 0.02
"""Relative: a pixel of the map is 1 % of SCR and 1.7 % of X/R, and the page keeps three digits."""


def test_a_drag_moves_the_grid_and_redraws(opened: ExplorerPage) -> None:
    before = opened.counts()
    way = [
        opened.place(across, up)
        for across, up in zip(np.linspace(0.2, 0.8, 12), np.linspace(0.9, 0.2, 12), strict=True)
    ]
    opened.page.drag([place.point for place in way])
    opened.redrawn(before, "linear", "emt")
    assert opened.changes()["scr"] == pytest.approx(way[-1].scr, rel=ONE_PIXEL)
    assert opened.changes()["x_over_r"] == pytest.approx(way[-1].x_over_r, rel=ONE_PIXEL)
    assert opened.counts()["map"] == before["map"], "the map does not depend on the place of the cross-hair"


def test_a_click_and_the_arrow_keys_move_the_grid(opened: ExplorerPage) -> None:
    page, before = opened.page, opened.counts()
    place = opened.place(0.7, 0.8)
    page.click(place.point)
    opened.redrawn(before, "linear", "emt")
    clicked = opened.changes()
    assert clicked["scr"] == pytest.approx(place.scr, rel=ONE_PIXEL)
    before = opened.counts()
    for _ in range(3):
        page.key("ArrowLeft")
    opened.redrawn(before, "linear", "emt")
    # Half a second after the last key, or between two keys that come slowly, the address follows.
    page.wait("window.page.store.history[window.page.store.at].scr === window.page.store.state.scr")
    assert opened.changes()["scr"] < 0.95 * clicked["scr"]
    assert opened.changes()["x_over_r"] == clicked["x_over_r"]


def test_a_typed_value_counts(opened: ExplorerPage) -> None:
    """With a unit or without, with a decimal comma, with a sign and an exponent."""
    for typed, value in (("3", 0.6), ("3.5 kW", 0.7), ("2,5", 0.5), ("-1.5e0 kW", -0.3), ("-1200 W", -0.24)):
        before = opened.counts()
        opened.page.type(opened.field("P_pu"), typed)
        opened.redrawn(before, "linear", "emt", "map")
        assert opened.changes()["P_pu"] == pytest.approx(value), typed


@pytest.mark.parametrize(
    ("path", "typed", "named"), [("P_pu", "fast", "kW"), ("P_pu", "3 V", "kW"), ("scr", "0", "SCR")]
)
def test_a_bad_value_is_marked_and_breaks_nothing(opened: ExplorerPage, path: str, typed: str, named: str) -> None:
    field, page = opened.field(path), opened.page
    table = opened.table()
    page.type(field, typed)
    page.wait(f'document.querySelector("{field}").getAttribute("aria-invalid") === "true"')
    fault = page.evaluate(
        f"document.getElementById(document.querySelector(\"{field}\").getAttribute('aria-describedby')).innerText"
    )
    assert named in fault
    assert any(digit in fault for digit in "0123456789"), "the limits are told"
    opened.settle()
    assert opened.table() == table
    assert path not in opened.changes()
    before = opened.counts()
    page.type(field, "3.3")
    opened.redrawn(before, "linear", "emt")
    assert page.evaluate(f'document.querySelector("{field}").getAttribute("aria-invalid")') is None
    assert path in opened.changes()
    # The browser's console lists each refused state (422); nothing else went wrong.
    assert all("422" in fault for fault in page.faults)
    page.faults.clear()


def test_undo_and_redo(opened: ExplorerPage) -> None:
    page = opened.page
    assert page.evaluate("[undo.disabled, redo.disabled]") == [True, True]
    page.click(opened.place(0.7, 0.3).point)
    first = opened.changes()
    page.type(opened.field("P_pu"), "1")
    second = opened.changes()
    assert second == {**first, "P_pu": 0.2}
    before = opened.counts()
    page.click("#undo")
    opened.redrawn(before, "linear", "emt")
    assert opened.changes() == first
    page.click("#undo")
    assert opened.changes() == {}
    assert page.evaluate("[undo.disabled, redo.disabled]") == [True, False]
    page.evaluate("document.activeElement.blur()")
    page.key("z", "Control", "Shift")
    assert opened.changes() == first
    page.click("#redo")
    assert opened.changes() == second
    page.evaluate("document.activeElement.blur()")
    page.key("z", "Control")
    assert opened.changes() == first


def test_a_link_opens_the_same_state(explorer: Explorer, opened: ExplorerPage, new_page: Callable[..., Page]) -> None:
    page = opened.page
    page.click(opened.place(0.7, 0.3).point)
    page.click("#hold")
    page.type(opened.field("P_pu"), "-1")
    before = opened.counts()
    page.click(opened.place(0.3, 0.8).point)
    opened.redrawn(before, "linear", "emt")
    address = page.evaluate("location.href")
    other = ExplorerPage(new_page(), address)
    assert other.changes() == opened.changes()
    assert other.table() == opened.table()
    assert other.page.evaluate("hold.checked") is True
    broken = ExplorerPage(new_page(), explorer.address + "#" + "not a state")
    assert "link" in broken.text("#notice")
    assert broken.table()


def test_held_gains_stay_while_the_grid_moves(explorer: Explorer, opened: ExplorerPage) -> None:
    page = opened.page
    here = opened.gains()
    assert all(here.values())
    before = opened.counts()
    page.click("#hold")
    opened.redrawn(before, "linear", "emt", "map")
    before = opened.counts()
    page.click(opened.place(0.85, 0.15).point)
    opened.redrawn(before, "linear", "emt")
    start = explorer.session.info()["defaults"]
    assert opened.changes()["hold"] == {"scr": start["scr"], "x_over_r": start["x_over_r"]}
    assert opened.gains() == here
    before = opened.counts()
    page.click("#hold")
    opened.redrawn(before, "linear", "emt", "map")
    assert all(gains != here[name] for name, gains in opened.gains().items())


def test_every_kind_of_event_is_simulated(explorer: Explorer, opened: ExplorerPage) -> None:
    page = opened.page
    kinds = [event["kind"] for event in explorer.session.info()["events"]]
    assert kinds == ["step", "grid", "phase", "sag", "ramp", "voltage_set_point"]
    pictures = set()
    for kind in [*kinds[1:], "step"]:
        before = opened.counts()
        page.choose("#event", kind)
        opened.redrawn(before, "emt")
        assert {"kind": "step", **opened.changes().get("event", {})}["kind"] == kind
        pictures.add(page.evaluate("document.getElementById('response').toDataURL()"))
        header = explorer.header("emt", explorer.state(**opened.changes()))
        for one in header["controllers"]:
            assert one["verdict"] in opened.said()[one["name"]], kind
    assert len(pictures) == len(kinds), "each event has its own response"


def test_the_keyboard_alone_reaches_everything(opened: ExplorerPage) -> None:
    page = opened.page
    page.evaluate("document.body.focus()")
    reached: list[str] = []
    describe = (
        "(() => { const e = document.activeElement; const s = getComputedStyle(e);"
        "const ring = s.outlineStyle !== 'none' && parseFloat(s.outlineWidth) >= 1;"
        "return [e.dataset.path || e.id || e.tagName, ring]; })()"
    )
    for _ in range(150):
        page.key("Tab")
        name, ringed = page.evaluate(describe)
        if name == "BODY" or (reached and name == reached[0] and len(reached) > 20):
            break
        assert ringed, f"{name} has the focus and does not show it"
        reached.append(name)
    wanted = {"link", "save", "figure", "map", "hold", "event", "modes", "P_pu", "Q_pu", "scr", "x_over_r"}
    assert wanted <= set(reached), wanted - set(reached)


def test_two_tabs_do_not_disturb_each_other(explorer: Explorer, opened: ExplorerPage) -> None:
    page = opened.page
    other = ExplorerPage(page.browser.page_in(page.context), explorer.address)
    before = [one.counts() for one in (opened, other)]
    for share in (0.3, 0.5, 0.7):
        for one, across in ((opened, share), (other, 1.0 - share)):
            one.page.front()
            one.page.click(one.place(across, 0.4).point)
    for one, count in zip((opened, other), before, strict=True):
        one.page.front()
        one.redrawn(count, "linear", "emt")
    assert opened.changes()["scr"] == pytest.approx(opened.place(0.7, 0.4).scr, rel=ONE_PIXEL)
    assert other.changes()["scr"] == pytest.approx(other.place(0.3, 0.4).scr, rel=ONE_PIXEL)
    assert opened.table() != other.table()
    other.page.close()
    page.front()


def test_a_mode_is_chosen_and_says_what_moves_it(opened: ExplorerPage) -> None:
    page = opened.page
    page.evaluate("document.getElementById('modes').focus()")
    page.key("ArrowRight")
    page.wait("!document.getElementById('mode').hidden")
    page.wait("document.getElementById('mode').innerText.includes('moves it')")
    words = opened.text("#mode")
    assert any(
        math.isfinite(float(word))
        for word in words.replace("−", "-").split()
        if word.strip("-.").replace(".", "").isdigit()
    )
    page.key("Escape")
    page.wait("document.getElementById('mode').hidden")


def test_own_gains_make_a_further_controller(opened: ExplorerPage) -> None:
    page = opened.page
    names = list(opened.table())
    page.click("details:has(> .own) > summary")
    before = opened.counts()
    page.click("details:has(> .own) > button")
    opened.redrawn(before, "linear", "emt")
    table = opened.table()
    assert list(table) == [*names, "my own gains"]
    # They begin as those of the last controller, in another structure perhaps; the gains are the same numbers.
    assert opened.gains()["my own gains"] == opened.gains()[names[-1]]
    before = opened.counts()
    page.type(opened.field("own.D_p"), "900")
    opened.redrawn(before, "linear", "emt")
    own = opened.gains()["my own gains"]
    assert [text for name, text in own.items() if name.startswith("Gains in force: D_p")] == ["900"]
    assert opened.changes()["own"]["D_p"] == 900.0
    assert {name: opened.table()[name] for name in names} == {name: table[name] for name in names}


def test_controllers_are_shown_and_hidden(opened: ExplorerPage) -> None:
    page, before = opened.page, opened.counts()
    page.click("#table tbody tr:first-child input")
    opened.redrawn(before, "linear", "emt")
    assert opened.changes()["controllers"] == ["decoupled", "angle_damped"]
    first, *others = (row.get("EMT: peak i pu", "") for row in opened.table().values())
    assert not first.strip("–")
    assert all(float(text) > 0.1 for text in others)
