"""What a suite of tests is, as data: sources, grids, events, what is measured and what is asked."""

from __future__ import annotations

from dataclasses import dataclass

from vsgdesign.study.parameters.event import BASIS, Event
from vsgdesign.study.parameters.grid import Load, Place

READ, SECONDARY, OURS, USER = "read", "secondary", "ours", "user"
CONFIDENCES = (READ, SECONDARY, OURS, USER)
"""How far a number is known: read in its source, told by another document, chosen by this project, or by the user who
wrote the suite."""

SOURCE = "source"
"""Whose a limit is: that of the test's source, of this project (OURS), or of the author of a suite (USER)."""

ENVELOPE = "envelope"
"""``Criterion.measure`` of a criterion that is an envelope: the value is the largest excess over it, pu."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """Where a test's numbers come from."""

    document: str
    edition: str
    confidence: str
    """A name of :data:`CONFIDENCES`."""
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Criterion:
    """What is asked of a measured value. With neither limits nor envelope it is informational."""

    measure: str
    """A name of the registry ``compliance.measures.MEASURES``, or :data:`ENVELOPE`."""
    at_least: float | None = None
    at_most: float | None = None
    envelope: str | None = None
    """A name of the registry ``compliance.envelopes.ENVELOPES``: a signal between two curves over time."""
    given: tuple[tuple[str, float], ...] = ()
    """Parameters of the measure or the envelope, by name, in SI or pu as these say."""
    ours: bool = False
    """Whether the limits are chosen by this project and not given by the test's source."""

    judged: bool = True
    """False: the value is shown beside its limits or its envelope, and there is no verdict on it."""

    def limit_of(self, source: Source) -> str:
        """Whose its limits are in a test of this source: SOURCE, OURS or USER; empty where nothing is asked."""
        if self.informational:
            return ""
        if self.ours or source.confidence == OURS:
            return OURS
        return USER if source.confidence == USER else SOURCE

    @property
    def informational(self) -> bool:
        """Whether nothing is asked."""
        return not self.judged or (self.at_least is None and self.at_most is None and self.envelope is None)


@dataclass(frozen=True, kw_only=True)
class SuiteTest:
    """One test on one grid from one operating point: a row of the clause matrix for each controller."""

    id: str
    """Unique in its suite, such as ``phase +60 deg, SCR 20, X/R 10``."""
    group: str
    """What it belongs to, such as ``phase jump``: a heading of the matrix."""
    title: str
    source: Source
    scr: float
    x_over_r: float
    P_pu: float = 0.5
    Q_pu: float = 0.0
    V_g_pu: float = 1.0
    df_hz: float = 0.0
    """Frequency of the grid above nominal before the test, Hz."""
    load: Load | None = None
    """Before the test; elements in pu of the base impedance at the nominal frequency (R, ωL, 1/(ωC))."""
    events: tuple[Event, ...] = ()
    """Per unit, in the order of time after the beginning of the test. Before, the converter is at rest."""
    duration_s: float | None = None
    """After the last event; None: as long as the controller's settling time asks for."""
    silent_s: float = 0.2
    """After every change of the grid the schedule gets no estimate for this long, s."""
    T_at_most: float | None = None
    """Longest settling time T with which a controller is judged, s; None: its own, whatever it is."""
    criteria: tuple[Criterion, ...] = ()
    needs: tuple[str, ...] = ()
    """Why the test may not apply: ``storage`` and others that ``compliance.applies`` knows."""

    @property
    def place(self) -> Place:
        """The grid before the test."""
        return Place(self.scr, self.x_over_r, BASIS)

    @property
    def cleared_s(self) -> float:
        """When the last event, with its ramp, is over, s."""
        return max((event.end_s for event in self.events), default=0.0)


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Tests with their sources."""

    name: str
    title: str
    source: Source
    tests: tuple[SuiteTest, ...]
    about: str = ""
