"""What a suite of tests is, as data: sources, grids, events, what is measured and what is asked."""

from __future__ import annotations

from dataclasses import dataclass

from vsgdesign.parameters.network import Fault, Load, SynchroCheck
from vsgdesign.parameters.source import Sag

READ, SECONDARY, OURS, USER = "read", "secondary", "ours", "user"
CONFIDENCES = (READ, SECONDARY, OURS, USER)
"""How far a number is known: read in its source, told by another document, chosen by this project, or by the user who
wrote the suite."""

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
class SuiteEvent:
    """What changes at one instant of a test, per unit of the converter. None: does not change."""

    t_s: float
    """After the beginning of the test, s. Before, the converter is at rest."""
    scr: float | None = None
    x_over_r: float | None = None
    V_g_pu: float | None = None
    """Ends a sag, too."""
    sag: Sag | None = None
    """An unbalanced or balanced dip from now on, in place of V_g_pu."""
    df_hz: float | None = None
    """New frequency above nominal, Hz."""
    over_s: float = 0.0
    """Duration of a linear ramp of V_g_pu and df_hz, s."""
    phase_deg: float = 0.0
    P_pu: float | None = None
    Q_pu: float | None = None
    fault: Fault | None = None
    """A short circuit from now on; its R is in pu of the base impedance."""
    fault_cleared: bool = False
    load: Load | None = None
    """Load from now on; elements in pu of the base impedance at the nominal frequency (R, ωL, 1/(ωC))."""
    load_off: bool = False
    connected: bool | None = None
    """The breaker to the grid."""
    synchro_check: SynchroCheck | None = None
    """The breaker closes at the first instant from t_s on at which both of its sides are near each other."""


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
    """Before the test; elements per unit as in :class:`SuiteEvent`."""
    events: tuple[SuiteEvent, ...] = ()
    """In the order of time."""
    duration_s: float | None = None
    """After the last event; None: as long as the controller's settling time asks for."""
    silent_s: float = 0.2
    """After every change of the grid the schedule gets no estimate for this long, s."""
    criteria: tuple[Criterion, ...] = ()
    needs: tuple[str, ...] = ()
    """Why the test may not apply: ``storage`` and others that ``compliance.applies`` knows."""

    @property
    def cleared_s(self) -> float:
        """When the last event, with its ramp, is over, s."""
        return max((event.t_s + event.over_s for event in self.events), default=0.0)


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Tests with their sources."""

    name: str
    title: str
    source: Source
    tests: tuple[SuiteTest, ...]
    about: str = ""
