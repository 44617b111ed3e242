"""A converter with its filter: ratings, sampled bridge, limits."""

from __future__ import annotations

from dataclasses import dataclass

from vsgdesign.equations.limiters import LimiterRatings
from vsgdesign.equations.power_loops import References
from vsgdesign.frames import base_impedance, linear_modulation_limit, rated_current_rms, rms_to_peak

UNLIMITED_PU = 1e6
"""A current limit so far out of reach that the limiter never acts (infinity would make NaN of 0·∞)."""


@dataclass(frozen=True, kw_only=True)
class Converter:
    """Ratings and the sampled bridge."""

    S_rated: float
    """VA."""
    V_rated_rms: float
    """Phase-to-neutral, V."""
    omega_n: float
    """Nominal angular frequency, rad/s."""
    V_dc: float
    f_sw: float
    """Carrier frequency, Hz."""
    samples_per_carrier: int
    delay_samples: int
    """Samples between measuring and applying: 0 or 1."""
    zero_sequence: bool
    """Min-max zero-sequence injection (limit V_dc/√3) instead of plain sine-triangle (V_dc/2)."""
    current_limit_pu: float | None
    """Limit of the converter-current reference in pu of the rated peak; None: no limit."""
    V_min_pu: float
    V_max_pu: float

    @property
    def T_s(self) -> float:
        """Sampling period of the controller, s."""
        return 1.0 / (self.f_sw * self.samples_per_carrier)

    @property
    def Z_base(self) -> float:
        """Base impedance, Ω."""
        return base_impedance(self.S_rated, self.V_rated_rms)

    @property
    def I_rated_pk(self) -> float:
        """Rated phase current, A peak."""
        return rms_to_peak(rated_current_rms(self.S_rated, self.V_rated_rms))

    @property
    def V_limits_rms(self) -> tuple[float, float]:
        """Least and largest phase voltage that is not flagged, V rms."""
        return self.V_min_pu * self.V_rated_rms, self.V_max_pu * self.V_rated_rms

    def references(self, P_ref: float = 0.0, Q_ref: float = 0.0) -> References:
        """Set points of the power loops, W and var, at nominal frequency and rated voltage."""
        return References(P_ref, Q_ref, self.omega_n, self.V_rated_rms)

    @property
    def v_max_pk(self) -> float:
        """Bridge-voltage limit, V peak."""
        return linear_modulation_limit(self.V_dc, self.zero_sequence)


@dataclass(frozen=True)
class Filter:
    """LC or LCL filter. An LC filter has L_2 = R_2 = 0."""

    L_1: float
    R_1: float
    C: float
    R_c: float = 0.0
    L_2: float = 0.0
    R_2: float = 0.0


def limiter_ratings(converter: Converter, filter_: Filter) -> LimiterRatings:
    """Ratings from which a current limiter computes its constants."""
    c = converter
    limit_pu = UNLIMITED_PU if c.current_limit_pu is None else c.current_limit_pu
    return LimiterRatings(
        T_s=c.T_s,
        V_rated_pk=rms_to_peak(c.V_rated_rms),
        I_rated_pk=c.I_rated_pk,
        i_max_pk=limit_pu * c.I_rated_pk,
        Z_base=c.Z_base,
        omega_0=c.omega_n,
        R_2=filter_.R_2,
        L_2=filter_.L_2,
        V_low_pu=c.V_min_pu,
        V_high_pu=c.V_max_pu,
    )
