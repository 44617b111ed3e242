"""Figures over time: one overlay for each group of tests, and one figure for each test that a controller fails."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from vsgdesign.campaigns.compliance.evidence import MOST_FIGURES, REST_S, Evidence, figures_of
from vsgdesign.campaigns.compliance.measuring import Trace
from vsgdesign.campaigns.compliance.rows import FAIL
from vsgdesign.execution.executors import Each
from vsgdesign.report.compliance.arranged import Arranged, Group, Tested
from vsgdesign.report.compliance.heat import heat_sketches
from vsgdesign.report.drawing.plot import Band, Curve, Plot, plot_sketch
from vsgdesign.report.drawing.sketch import Sketch, svg, svg_file
from vsgdesign.report.drawing.style import DASHES

Array = NDArray[np.float64]

Traces = Mapping[str, Evidence]
"""Evidence by the name of its file, the field ``csv`` of a row."""

MOST_CURVES = 9
"""Curves of one overlay: more cannot be told apart."""

_MOST_NAMES = 4
"""Tests of an overlay that its caption names."""

DRAWN_ALWAYS = ("P_pu", "i_phase_pu", "f_hz")
"""Signals of every figure; those with limits come on top."""

_LABELS = {
    "P_pu": ("Active power", "P [pu]", 3.0),
    "Q_pu": ("Reactive power", "Q [pu]", 3.0),
    "i_phase_pu": ("Largest phase current of 5 ms", "i [pu]", 3.0),
    "i_s_pu": ("Largest converter current of 5 ms", "i_s [pu]", 3.0),
    "V_pu": ("Voltage reference", "V [pu]", 2.0),
    "f_hz": ("Frequency", "f [Hz]", 0.0),
    "delta_rad": ("Angle to the grid", "δ [rad]", 30.0),
    "P_dc_pu": ("Power of the dc link", "P_dc [pu]", 3.0),
    "v_dc_pu": ("Voltage of the dc link", "v_dc [pu]", 2.0),
}
"""Title, axis, and how far the scale may go for a curve that has gone away."""

_PEAKS = ("i_phase_pu", "i_s_pu")

_FREQUENCY_ROOM_HZ = 10.0


@dataclass(frozen=True, eq=False)
class TestFigure:
    """The plots of a test with a failing row, or of a group."""

    name: str
    title: str
    caption: str
    plots: tuple[Sketch, ...]
    """Empty where they stand in a file and on the page alone, which have their text."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """A figure as it is asked for: what it shows, before any trace is read."""

    name: str
    title: str
    caption: str
    runs: tuple[tuple[int, str], ...]
    """Controllers by their places, and the names of the traces."""
    judged: tuple[tuple[int, ...], ...] = ()
    """Which runs give the envelopes, by their places in ``runs``: the first of these that have some."""
    sketched: bool = True
    """Whether its plots are asked for besides their text."""


@dataclass(frozen=True, eq=False)
class Made:
    """A figure that was asked for, as the text of a file and as a part of a page; None: none of its traces is there."""

    figure: TestFigure | None
    file: str = ""
    html: str = ""
    missing: tuple[str, ...] = ()
    """Traces that are not there."""


@dataclass(frozen=True, kw_only=True)
class Painter:
    """Draws figures of a result. It goes to other processes."""

    controllers: tuple[str, ...]
    colours: tuple[str, ...]
    limits_pu: Mapping[str, float | None]
    """Current limits of the controllers."""
    f_n_hz: float
    traces: Traces

    def made(self, asked: Sequence[Asked]) -> list[Made]:
        """Each of these figures."""
        return [self._made(one) for one in asked]

    def _made(self, asked: Asked) -> Made:
        read = [self._read(name) for _, name in asked.runs]
        missing = tuple(name for (_, name), found in zip(asked.runs, read, strict=True) if found is None)
        curves = [(k, found) for (k, _), found in zip(asked.runs, read, strict=True) if found is not None]
        if not curves:
            return Made(None, missing=missing)
        some = (_bands([found for place in places if (found := read[place]) is not None]) for places in asked.judged)
        plots = self._plots(curves, next((bands for bands in some if bands), []))
        file = svg_file(plots, asked.title, (asked.caption,))
        html = "\n".join(svg(one, "plot") for one in plots)
        figure = TestFigure(asked.name, asked.title, asked.caption, plots if asked.sketched else ())
        return Made(figure, file, html, missing)

    def _read(self, name: str) -> Evidence | None:
        found = self.traces.get(name)
        return None if found is None or len(found.trace.t_s) < 2 else found

    def _plots(self, curves: Sequence[_Curve], bands: Sequence[tuple[str, Band]]) -> tuple[Sketch, ...]:
        judged = [signal for signal, _ in bands]
        signals = [*DRAWN_ALWAYS, *dict.fromkeys(name for name in judged if name not in DRAWN_ALWAYS)]
        return tuple(self._plot(signal, curves, [band for of, band in bands if of == signal]) for signal in signals)

    def _plot(self, signal: str, curves: Sequence[_Curve], bands: Sequence[Band]) -> Sketch:
        title, label, most = _LABELS.get(signal, (signal, signal, 3.0))
        within = (-most, most)
        if signal == "f_hz":
            within = (self.f_n_hz - _FREQUENCY_ROOM_HZ, self.f_n_hz + _FREQUENCY_ROOM_HZ)
        levels = []
        if signal in _PEAKS:
            shown = (self.limits_pu.get(self.controllers[k]) for k, _ in curves)
            levels = [(value, "current limit") for value in sorted({float(one) for one in shown if one is not None})]
        drawn = [Curve(e.trace.t_s, shown_signal(e.trace, signal), self.colours[k], dashes_of(k)) for k, e in curves]
        return plot_sketch(Plot(title, label, drawn, bands, levels, within))


def _of_test(test: Tested, sketched: bool) -> Asked:
    """All controllers of one test, with the envelopes of those that fail it."""
    runs = _runs(test)
    failing = tuple(place for place, (k, _) in enumerate(runs) if _fails(test, k))
    who = ", ".join(row["controller"] for row in test.known if row["verdict"] == FAIL)
    caption = f"{test.network}. {f'Failed by {who}.' if who else ''}".strip()
    judged = (failing, tuple(range(len(runs))))
    return Asked(name=test.anchor, title=test.test, caption=caption, runs=runs, judged=judged, sketched=sketched)


def _of_group(group: Group, controllers: int) -> Asked:
    """Some tests of a group over each other, evenly spread; of tests with envelopes one alone."""
    enveloped = [test for test in group.tests if any(line.enveloped for line in test.lines)]
    tests = [max(enveloped, key=_excess)] if enveloped else chosen(group, controllers)
    said = _caption(group, tests)
    if enveloped and len(group.tests) > 1:
        said += " Each test has its own envelope, so the one with the largest excess is drawn."
    runs = tuple(run for test in tests for run in _runs(test))
    judged = (tuple(range(len(runs))),) if enveloped else ()
    return Asked(name="", title=group.name, caption=said, runs=runs, judged=judged)


def _runs(test: Tested) -> tuple[tuple[int, str], ...]:
    """The runs of a test: one that does not apply or is impossible has none."""
    return tuple((k, row["csv"]) for k, row in enumerate(test.rows) if row is not None and row.get("csv"))


def chosen(group: Group, controllers: int) -> list[Tested]:
    """The tests of an overlay: the first, the last and some between them."""
    most = max(MOST_CURVES // max(controllers, 1), 1)
    n = len(group.tests)
    if n <= most:
        return list(group.tests)
    places = sorted({round(k * (n - 1) / max(most - 1, 1)) for k in range(most)})
    return [group.tests[k] for k in places]


def shown_signal(trace: Trace, signal: str) -> Array:
    """A signal as it is drawn: of the current the largest in the last 5 ms, because its length pulses with the phases.

    The rows of a file are as far apart where little happens, so that the curve means the same everywhere.
    """
    y = getattr(trace, signal)
    if signal not in _PEAKS:
        return y
    found, t = y.copy(), trace.t_s
    for back in range(1, len(t)):
        near = t[back:] - t[:-back] < REST_S - 1e-9
        if not near.any():
            break
        np.copyto(found[back:], np.maximum(found[back:], y[:-back]), where=near)
    return found


_Curve = tuple[int, Evidence]
"""A controller by its place, and a run of it."""


def dashes_of(index: int) -> tuple[float, ...]:
    """Dashes of a controller's curves, as multiples of their width."""
    dash = DASHES[index % len(DASHES)]
    return () if isinstance(dash, str) else tuple(dash[1])


def _caption(group: Group, tests: Sequence[Tested]) -> str:
    """Which tests of a group are drawn."""
    names = [f"{test.test}{f' ({test.besides})' if test.besides else ''}" for test in tests]
    if len(names) > _MOST_NAMES:
        names = [f"from {names[0]} to {names[-1]}"]
    count = "All" if len(tests) == len(group.tests) else f"{len(tests)} of"
    if len(group.tests) == 1:
        return f"{names[0]}."
    return f"{count} {len(group.tests)} tests: {'; '.join(names)}."


def _excess(test: Tested) -> float:
    """How far the worst controller is outside of an envelope."""
    found = [check["value"] for row in test.known for check in row["checks"] if check.get("envelope")]
    return max((value for value in found if value is not None), default=0.0)


def _fails(test: Tested, index: int) -> bool:
    row = test.rows[index]
    return row is not None and row["verdict"] == FAIL


def _bands(found: Sequence[Evidence]) -> list[tuple[str, Band]]:
    """The envelopes with the names of their signals; the same curves of several controllers once."""
    bands: dict[tuple[str, bytes, bytes], Band] = {}
    for evidence in found:
        for one in evidence.limits:
            key = (one.signal, one.low.tobytes(), one.high.tobytes())
            bands.setdefault(key, Band(evidence.trace.t_s, one.low, one.high))
    return [(signal, band) for (signal, _, _), band in bands.items()]


MOST_INSIDE = 1_200_000
"""Bytes of these figures that are a part of the page itself. The others are files beside it."""

MOST_ON_PAPER = 24
"""Figures of failing tests on paper."""

_AT_ONCE = 12
"""Figures that a worker draws in one go, in a tenth of a second."""


@dataclass(frozen=True)
class Drawn:
    """All figures of a result. ``beyond``: tests with a failing row for which there was no room."""

    groups: Mapping[tuple[str, str], TestFigure]
    tests: Mapping[str, TestFigure]
    """Of these the first :data:`MOST_ON_PAPER` have their plots."""
    files: Mapping[str, str]
    """Texts of the files of tests, by the names of their figures."""
    inside: Mapping[str, Markup]
    maps: Sequence[Sketch]
    beyond: int
    missing: int


def draw(arranged: Arranged, document: Mapping[str, Any], traces: Traces, each: Each = map) -> Drawn:
    """Every figure of the page and of the PDF. ``each`` may be the ``map`` of workers that read the traces."""
    converter = document.get("converter") or {}
    painter = Painter(
        controllers=arranged.controllers,
        colours=arranged.colours,
        limits_pu={one["controller"]: one["current_limit_pu"] for one in converter.get("limits") or ()},
        f_n_hz=float(converter.get("f_n_hz") or 50.0),
        traces=traces,
    )
    groups = list(arranged.groups())
    failing = {(test.suite, test.test): test for test in arranged.tests() if test.fails}
    asked = [_of_group(group, len(arranged.controllers)) for group in groups]
    asked += [_of_test(failing[key], k < MOST_ON_PAPER) for k, key in enumerate(figures_of(document["rows"]))]
    parts = each(painter.made, [asked[k : k + _AT_ONCE] for k in range(0, len(asked), _AT_ONCE)])
    made = [one for part in parts for one in part]
    of_tests = [(one.figure, one) for one in made[len(groups) :] if one.figure is not None]
    inside, size = {}, 0
    for figure, one in of_tests:
        if size > MOST_INSIDE:
            break
        inside[figure.name] = Markup(one.html)
        size += len(one.html)
    found = zip(groups, made[: len(groups)], strict=True)
    return Drawn(
        groups={(group.suite, group.name): one.figure for group, one in found if one.figure is not None},
        tests={figure.name: figure for figure, _ in of_tests},
        files={figure.name: one.file for figure, one in of_tests},
        inside=inside,
        maps=heat_sketches(document.get("maps") or ()),
        beyond=max(sum(any(row.get("csv") for row in test.known) for test in failing.values()) - MOST_FIGURES, 0),
        missing=len({name for one in made for name in one.missing}),
    )
