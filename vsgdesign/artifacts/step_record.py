"""Steps for which a certificate proves that no limit acts, as a gain table's file keeps them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.guarded_file import is_number

Pair = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class StepRow:
    """The largest step of each kind, alone, to an operating point within limits of SCR, P (W) and Q (var).

    The steps are None where none is possible.
    """

    scr: Pair
    P: Pair
    Q: Pair
    rest_current_pu: float | None
    """Largest converter current at rest that was seen, pu of the rated one. None: there is no operating point."""
    proof: str
    """``gap-free``: at every point; ``gridded``: at points, with a margin."""
    P_ref: float | None = None
    """W."""
    Q_ref: float | None = None
    """var."""
    phase: float | None = None
    """Jump of the grid's phase, rad."""
    V_g: float | None = None
    """V, phase rms."""
    omega_g: float | None = None
    """rad/s."""

    @property
    def possible(self) -> bool:
        """Whether there is a step for which no limit acts."""
        return self.P_ref is not None


@dataclass(frozen=True, kw_only=True)
class StepStatement:
    """Where no limit acts: the limits, the function whose sublevel sets stay clear of them, and the steps."""

    limiter: str
    """Name of the current limiter."""
    current_pu: float | None
    """Current at which it begins to act; None: there is no limit of the current."""
    soft: bool
    """Whether that is the limiter's soft limit."""
    V_low_pu: float | None
    V_high_pu: float | None
    """Between which V has to stay; None: V is free."""
    clips_V: bool
    """Whether the limiter clips V at the two voltages."""
    decay: float | None = None
    """Decay rate of the function, 1/s; None where there is none."""
    P: tuple[tuple[float, ...], ...] = ()
    """Its matrix over the scaled states of the certificate."""
    proof: str = "gridded"
    """How the decay is proved: ``gap-free`` or ``gridded``."""
    rows: tuple[StepRow, ...] = ()
    reason: str | None = None
    """Why there are no rows."""

    def as_document(self) -> dict[str, Any]:
        """JSON's types."""
        return plain({**vars(self), "rows": [vars(row) for row in self.rows]})


_TEXTS = ("limiter", "proof", "reason")
_TRUTHS = ("soft", "clips_V")
_PAIRS = ("scr", "P", "Q")


def step_statement(document: Any) -> StepStatement:
    """The statement of a document. Raises ValueError where it is none."""
    try:
        rows = tuple(StepRow(**_checked(row, _PAIRS)) for row in document["rows"])
        matrix = tuple(tuple(float(value) for value in row) for row in document["P"])
        rest = {name: value for name, value in document.items() if name not in ("rows", "P")}
        return StepStatement(**_checked(rest, ()), rows=rows, P=matrix)
    except (TypeError, KeyError, ValueError, AttributeError) as error:
        raise ValueError(f"is not what certify writes ({error})") from error


def _checked(values: dict[str, Any], pairs: tuple[str, ...]) -> dict[str, Any]:
    """Values of the right kinds, lists as tuples. Raises ValueError."""
    found = {}
    for name, value in values.items():
        if name in pairs:
            low, high = value
            good, value = is_number(low) and is_number(high), (low, high)
        elif name in _TEXTS:
            good = value is None or isinstance(value, str)
        elif name in _TRUTHS:
            good = isinstance(value, bool)
        else:
            good = value is None or is_number(value)
        if not good:
            raise ValueError(f"{name}: {value!r}")
        found[name] = value
    return found
