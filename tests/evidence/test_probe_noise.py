"""A piece of the evidence on the probe's noise: one converter, one draw."""

from __future__ import annotations

from evidence.probe_noise import at_rest, converter_of, noise_of


def test_the_probe_hardly_moves_the_power_at_rest() -> None:
    """1 MVA at SCR 20, 10 s: 0.11 % of the rating is asked for. Lines whose signs change at once move P by 0.37 %."""
    converter = converter_of("1 MVA")
    found = noise_of(converter, at_rest(converter, 20.0, seed=3, duration_s=14.0), from_s=4.0)
    assert found["valid"] == 1.0
    assert found["P_pct"] < 0.11
    assert found["Q_pct"] < 0.11
