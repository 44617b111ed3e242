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
from vsgdesign.report.compliance.arranged import Arranged, Group, Tested
from vsgdesign.report.compliance.heat import heat_sketches
from vsgdesign.report.drawing.plot import Band, Curve, Plot, plot_sketch
from vsgdesign.report.drawing.sketch import Sketch, svg
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


class Drawer:
    """Draws figures of a result, and remembers which traces are missing."""

    def __init__(self, arranged: Arranged, traces: Traces, converter: Mapping[str, Any]) -> None:
        self.arranged = arranged
        self.traces = traces
        self.missing: set[str] = set()
        self._f_n_hz = float(converter.get("f_n_hz") or 50.0)
        self._limits = {one["controller"]: one["current_limit_pu"] for one in converter.get("limits") or ()}

    def of_test(self, test: Tested) -> TestFigure | None:
        """All controllers of one test. None: no trace of it is there."""
        found = [(k, evidence) for k, row in enumerate(test.rows) if row is not None and (evidence := self._read(row))]
        if not found:
            return None
        failing = [(k, evidence) for k, evidence in found if _fails(test, k)]
        bands = _bands([evidence for _, evidence in failing]) or _bands([evidence for _, evidence in found])
        who = ", ".join(row["controller"] for row in test.known if row["verdict"] == FAIL)
        caption = f"{test.network}. {f'Failed by {who}.' if who else ''}"
        return TestFigure(test.anchor, test.test, caption.strip(), self._plots(found, bands))

    def of_group(self, group: Group) -> TestFigure | None:
        """Some tests of a group over each other, evenly spread; of tests with envelopes one alone. None: no trace."""
        enveloped = [test for test in group.tests if any(line.enveloped for line in test.lines)]
        tests = [max(enveloped, key=_excess)] if enveloped else self.chosen(group)
        curves = [
            (k, evidence)
            for test in tests
            for k, row in enumerate(test.rows)
            if row is not None and (evidence := self._read(row)) is not None
        ]
        if not curves:
            return None
        said = _caption(group, tests)
        if enveloped and len(group.tests) > 1:
            said += " Each test has its own envelope, so the one with the largest excess is drawn."
        bands = _bands([evidence for _, evidence in curves]) if enveloped else []
        return TestFigure("", group.name, said, self._plots(curves, bands))

    def chosen(self, group: Group) -> list[Tested]:
        """The tests of an overlay: the first, the last and some between them."""
        most = max(MOST_CURVES // max(len(self.arranged.controllers), 1), 1)
        n = len(group.tests)
        if n <= most:
            return list(group.tests)
        places = sorted({round(k * (n - 1) / max(most - 1, 1)) for k in range(most)})
        return [group.tests[k] for k in places]

    def _read(self, row: Mapping[str, Any]) -> Evidence | None:
        name = row.get("csv")
        if not name:
            return None  # a test that does not apply or is impossible is not run
        found = self.traces.get(name)
        if found is None or len(found.trace.t_s) < 2:
            self.missing.add(name)
            return None
        return found

    def _plots(self, curves: Sequence[_Curve], bands: Sequence[tuple[str, Band]]) -> tuple[Sketch, ...]:
        judged = [signal for signal, _ in bands]
        signals = [*DRAWN_ALWAYS, *dict.fromkeys(name for name in judged if name not in DRAWN_ALWAYS)]
        return tuple(self._plot(signal, curves, [band for of, band in bands if of == signal]) for signal in signals)

    def _plot(self, signal: str, curves: Sequence[_Curve], bands: Sequence[Band]) -> Sketch:
        title, label, most = _LABELS.get(signal, (signal, signal, 3.0))
        within = (-most, most)
        if signal == "f_hz":
            within = (self._f_n_hz - _FREQUENCY_ROOM_HZ, self._f_n_hz + _FREQUENCY_ROOM_HZ)
        levels = []
        if signal in _PEAKS:
            shown = (self._limits.get(self.arranged.controllers[k]) for k, _ in curves)
            levels = [(value, "current limit") for value in sorted({float(one) for one in shown if one is not None})]
        drawn = [
            Curve(e.trace.t_s, shown_signal(e.trace, signal), self.arranged.colours[k], dashes_of(k)) for k, e in curves
        ]
        return plot_sketch(Plot(title, label, drawn, bands, levels, within))


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


@dataclass(frozen=True)
class Drawn:
    """All figures of a result. ``beyond``: tests with a failing row for which there was no room."""

    groups: Mapping[tuple[str, str], TestFigure]
    tests: Mapping[str, TestFigure]
    inside: Mapping[str, Markup]
    maps: Sequence[Sketch]
    beyond: int
    missing: int


def draw(arranged: Arranged, document: Mapping[str, Any], traces: Traces) -> Drawn:
    """Every figure of the page and of the PDF."""
    drawer = Drawer(arranged, traces, document.get("converter") or {})
    groups = {(group.suite, group.name): drawer.of_group(group) for group in arranged.groups()}
    failing = {(test.suite, test.test): test for test in arranged.tests() if test.fails}
    chosen = [failing[key] for key in figures_of(document["rows"])]
    tests = {test.anchor: drawer.of_test(test) for test in chosen}
    inside, size = {}, 0
    for anchor, figure in tests.items():
        if figure is None or size > MOST_INSIDE:
            continue
        inside[anchor] = Markup("\n").join(svg(one, "plot") for one in figure.plots)
        size += len(inside[anchor])
    return Drawn(
        groups={key: figure for key, figure in groups.items() if figure is not None},
        tests={anchor: figure for anchor, figure in tests.items() if figure is not None},
        inside=inside,
        maps=heat_sketches(document.get("maps") or ()),
        beyond=max(sum(any(row.get("csv") for row in test.known) for test in failing.values()) - MOST_FIGURES, 0),
        missing=len(drawer.missing),
    )
