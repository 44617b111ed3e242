"""A mode in words: how fast it oscillates, how fast it grows or decays, and which states take part in it."""

from __future__ import annotations

import math

from vsgdesign.stability.loci import Mode

_QUANTITIES = {
    "i_s": "converter current",
    "v_c": "capacitor voltage",
    "i_g": "grid current",
    "pending": "delayed bridge voltage",
    "delta": "angle",
    "omega_i": "frequency integrator",
    "V": "voltage integrator",
    "P_f": "P filter",
    "Q_f": "Q filter",
    "ripple_P": "notch of P",
    "mean_P": "notch of P",
    "ripple_Q": "notch of Q",
    "mean_Q": "notch of Q",
    "xi_v": "voltage-loop integrators",
    "xi_i": "current-loop integrators",
    "i_f": "low-pass of the transient impedance",
}
_LEAST_SHARE = 0.1
_MOST_NAMED = 3


def quantity_of(state: str) -> str:
    """The meaning of a state of the full-order model, both axes under one name; an unknown state has its own name."""
    for name in (state, state.removesuffix("_d").removesuffix("_q"), state.removesuffix("d").removesuffix("q")):
        if name in _QUANTITIES:
            return _QUANTITIES[name]
    return state


def shares_of(mode: Mode) -> dict[str, float]:
    """Participation by quantity, the largest first, from the states of the mode."""
    shares: dict[str, float] = {}
    for state, share in mode.participation:
        shares[quantity_of(state)] = shares.get(quantity_of(state), 0.0) + share
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def mode_in_words(mode: Mode) -> str:
    """Frequency, growth or decay rate, damping ratio, and the quantities with the largest participation."""
    rate, frequency = mode.s.real, abs(mode.s.imag) / (2.0 * math.pi)
    what = (
        f"a mode that swings at {frequency:.3g} Hz in P and Q"
        if frequency > 1e-3 * abs(rate)
        else "a mode that does not swing"
    )
    pace = f"and {'grows' if rate > 0.0 else 'decays'} at {abs(rate):.3g} 1/s"
    named = [(name, share) for name, share in shares_of(mode).items() if share >= _LEAST_SHARE][:_MOST_NAMED]
    states = ", ".join(f"{name} {100.0 * share:.0f} %" for name, share in named)
    damping = f"{mode.damping:.2g}".replace("-", "−")
    return f"{what} {pace} (damping ratio {damping}; {states})"
