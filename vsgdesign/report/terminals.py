"""What verbs without a page print on a terminal: a survival measurement, and a closed-form design."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from vsgdesign.errors import counted, share_percent
from vsgdesign.report.drawing.quantities import DASH
from vsgdesign.report.page.blocks import Block, Table, Where, words

if TYPE_CHECKING:
    from vsgdesign.design import ClosedFormDesign
    from vsgdesign.study.parameters import Study


_LONGEST = 60
"""Letters of a value that a terminal shows."""

_SHOWN = 8
"""Lost cases of each controller that a terminal names."""


def survival_blocks(document: dict[str, Any]) -> list[Block]:
    """One row for each controller, then the groups in which something was lost, and the first lost cases."""
    head = (
        "controller",
        "survived",
        "stale for ever",
        "left out",
        "largest current [pu]",
        "first 5 ms [pu]",
        "recovery [s]",
        "worst [s]",
        "swing [rad]",
    )
    title = f"{document['title']}: limit {document['limit_pu']:g} pu"
    rows = tuple(_row(name, one) for name, one in document["variants"].items())
    lines = [line for name, one in document["variants"].items() for line in _lost(name, one)]
    return [Table(title, head, rows, on=Where.TERMINAL), words(*lines, on=Where.TERMINAL)]


def _row(name: str, one: dict[str, Any]) -> tuple[str, ...]:
    near, ever, T = one["stale_to_1_s"], one["for_ever"], one["settling_time"]
    return (
        name,
        _share(near),
        _share(ever),
        str(sum(figures["cases"] - figures["judged"] for figures in (near, ever))),
        _number(near["peak_pu"]),
        _number(near["first_peak_pu"]),
        _number(near["recovery_median"], T),
        _number(near["recovery_worst"], T),
        _number(near["swing_rad"]),
    )


def _lost(name: str, one: dict[str, Any]) -> list[str]:
    lost = [
        f"{group} {figures['judged'] - figures['survived']} of {figures['judged']}"
        for group, figures in one["groups"].items()
        if figures["survived"] < figures["judged"]
    ]
    lines = [f"{name} loses: {', '.join(lost)}"] if lost else []
    lines += [f"  {case['case']}: {case['status']}: {case['reason']}" for case in one["lost"][:_SHOWN]]
    more = len(one["lost"]) - _SHOWN
    return [*lines, f"  … and {more} more in cases.csv"] if more > 0 else lines


def _share(figures: dict[str, Any]) -> str:
    if not figures["judged"]:
        return DASH
    return f"{figures['survived']}/{figures['judged']} ({share_percent(figures['share'])})"


def _number(value: float | None, factor: float = 1.0) -> str:
    return DASH if value is None else f"{factor * value:.3g}"


_MOST_FIGURES = 40
"""Changed figures that a terminal shows, the largest changes first."""


def diff_blocks(document: dict[str, Any]) -> list[Block]:
    """What changed between two results: inputs, verdicts, then figures with both values."""
    inputs, verdicts, figures = (document[name] for name in ("inputs", "verdicts", "figures"))
    counts = [(len(inputs), "input"), (len(verdicts), "verdict"), (len(figures), "figure")]
    changed = ", ".join(counted(count, word) for count, word in counts if count)
    worse = f"{counted(document['worse'], 'verdict')} got worse" if document["worse"] else "No verdict got worse"
    said = f"Changed: {changed}. {worse}." if changed else "Nothing changed."
    marks = {True: "worse", False: "better"}
    by_size = sorted(figures, key=_relative_size, reverse=True)
    head = ("A", "B")
    return [
        words(said, on=Where.TERMINAL),
        *_changed("inputs", inputs, head, lambda _: ()),
        *_changed("verdicts", verdicts, (*head, ""), lambda one: (marks[one["worse"]],)),
        *_changed("figures, the largest changes first", by_size, (*head, "change"), lambda one: (_change(one),)),
    ]


def _changed(
    title: str,
    changes: Sequence[dict[str, Any]],
    head: tuple[str, ...],
    more: Callable[[dict[str, Any]], tuple[str, ...]],
) -> list[Block]:
    rows = tuple((" › ".join(one["place"]), _shown(one["a"]), _shown(one["b"]), *more(one)) for one in changes)
    rest = len(rows) - _MOST_FIGURES
    found: list[Block] = [Table(title, ("what", *head), rows[:_MOST_FIGURES], on=Where.TERMINAL)] if rows else []
    return [*found, words(f"… and {rest} more: --json gives all." if rest > 0 else "", on=Where.TERMINAL)]


def _shown(value: Any) -> str:
    if value is None:
        return DASH
    if isinstance(value, dict):
        return "there"
    if isinstance(value, float):
        return f"{value:.6g}"
    text = ", ".join(map(_shown, value)) if isinstance(value, list) else str(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def _change(one: dict[str, Any]) -> str:
    size = _relative(one)
    return DASH if not math.isfinite(size) else f"{100.0 * size:+.3g} %"


def _relative_size(one: dict[str, Any]) -> float:
    return abs(_relative(one))


def _relative(one: dict[str, Any]) -> float:
    """(b - a)/|a|; infinite where one of them is no number, or a is zero."""
    a, b = one["a"], one["b"]
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (a, b))
    return (b - a) / abs(a) if numbers and a else math.inf


_PLACE = ("controller", "SCR", "X/R")
_POINT = (("V", "pu"), ("δ", "°"), ("A", "W/rad"), ("D", "var/V"), ("PM of P", "°"), ("PM of Q", "°"))
_FIRST = (("K_ip", "rad/(s²W)"), ("D_p", "W·s/rad"), ("K_iq", "V/(s·var)"), ("D_q", "var/V"))
_REST = (("K_pq", "rad/(s²var)"), ("K_qp", "V/(s·W)"), ("k_P", "rad/(s·W)"), ("k_Q", "rad/(s·var)"))
_SYSTEM = (
    ("H", "s"),
    ("P–f droop", "kW/Hz"),
    ("P–f droop", "% of f_n"),
    ("Q–V droop", "kvar/V"),
    ("Q–V droop", "% of V_n"),
)


def design_blocks(study: Study, designs: Sequence[ClosedFormDesign], missing: Sequence[str] = ()) -> list[Block]:
    """Design points, margins, gains, inertia and droop; ``missing``: sentences on controllers without gains."""
    found: list[Block] = []
    if designs:
        c, on = study.converter, Where.TERMINAL
        title = f"{study.title}: design points (SCR on the {study.scr_basis} basis)"
        beyond = f"! the design point needs a voltage outside {c.V_min_pu:g} to {c.V_max_pu:g} pu"
        inside = all(d.point.V_within_limits for d in designs)
        more = [(d, [f"{value:.4g}" for value in d.gains[4:]]) for d in designs if any(d.gains[4:])]
        found += [
            _table(study, title, _POINT, [(d, _point(study, d)) for d in designs]),
            words("" if inside else beyond, on=on),
            _table(study, "gains", _FIRST, [(d, [f"{value:.5g}" for value in d.gains[:4]]) for d in designs]),
            *([_table(study, "gains that only coupled structures have", _REST, more)] if more else []),
            _table(study, "inertia and droop", _SYSTEM, [(d, _system(study, d)) for d in designs]),
            words("Droop in %: the deviation that rated power answers.", on=on),
        ]
    told = [spec.name for spec in study.controllers if spec.estimate != "truth"]
    of_estimates = f"{', '.join(told)}: estimates the grid; shown with the gains of the true one." if told else ""
    return [*found, words(of_estimates, *missing, on=Where.TERMINAL)]


def _table(
    study: Study,
    title: str,
    columns: Sequence[tuple[str, str]],
    rows: Sequence[tuple[ClosedFormDesign, Sequence[str]]],
) -> Table:
    """Units stand below the names, so that the table fits in 80 columns."""
    head = (*_PLACE, *(f"{name}\n[{unit}]" for name, unit in columns))
    return Table(title, head, tuple((*_place(study, d), *cells) for d, cells in rows), on=Where.TERMINAL)


def _place(study: Study, d: ClosedFormDesign) -> tuple[str, str, str]:
    place = d.grid.place(study.converter, study.scr_basis)
    return d.controller, f"{place.scr:.3g}", f"{place.x_over_r:.3g}"


def _point(study: Study, d: ClosedFormDesign) -> list[str]:
    mark = "" if d.point.V_within_limits else "!"
    return [
        f"{d.point.V_rms / study.converter.V_rated_rms:.3f}{mark}",
        f"{math.degrees(d.point.delta):.2f}",
        f"{d.point.A:.5g}",
        f"{d.point.D:.5g}",
        _angle(d.margins_P.phase_margin_deg),
        _angle(d.margins_Q.phase_margin_deg),
    ]


def _system(study: Study, d: ClosedFormDesign) -> list[str]:
    c = study.converter
    return [
        f"{d.inertia_s:.3g}",
        f"{d.droop_W_per_Hz / 1e3:.4g}",
        _share_of_rated(c.S_rated, d.gains.D_p * c.omega_n),
        f"{d.gains.D_q / 1e3:.4g}",
        _share_of_rated(c.S_rated, d.gains.D_q * c.V_rated_rms),
    ]


def _angle(value: float | None) -> str:
    return DASH if value is None else f"{value:.1f}"


def _share_of_rated(rated: float, stiffness: float) -> str:
    """The deviation in per cent that rated power corresponds to; none without droop."""
    if stiffness == 0.0:
        return "none"
    share = 100.0 * rated / stiffness
    return f"{share:.0f}" if share >= 1000.0 else f"{share:.3g}"
