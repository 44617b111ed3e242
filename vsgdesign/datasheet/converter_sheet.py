"""A converter as its datasheet describes it, in the units and conventions of a study."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Assumption:
    """A value that the datasheet does not give and that was assumed."""

    field: str
    text: str


@dataclass(frozen=True, kw_only=True)
class Datasheet:
    """Everything that a study of a converter needs, in SI, and where each value comes from."""

    title: str
    source: str
    S_rated: float
    V_rated_ll_rms: float
    f_n: float
    V_dc: float
    f_sw: float
    samples_per_carrier: int
    delay_samples: int
    modulation: str
    """``sine_triangle`` or ``min_max``."""
    current_limit_pu: float
    L_1: float
    R_1: float
    C: float
    """Per phase in star, F."""
    R_c: float
    """In series with each star capacitor."""
    L_2: float
    """0: an LC filter."""
    R_2: float
    scr: tuple[float, float]
    """Smallest and largest short-circuit ratio of its grids, on the impedance."""
    x_over_r: tuple[float, float]
    remarks: dict[str, str]
    """How a field was read, if the datasheet writes it differently from a study."""
    assumptions: tuple[Assumption, ...]
    notes: tuple[str, ...]
    """Facts that a user should know before anything is designed."""
    unused: tuple[str, ...]
    """Rows of the datasheet that no study needs."""
