"""Study texts that several tests of the EMT share."""

from __future__ import annotations

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.study.parameters import Study, study_from_text

GAINS = PowerLoopGains(K_ip=0.00767, D_p=2087.0, K_iq=0.115, D_q=0.687)
"""Table II's power-loop gains."""

FAST_GAINS = PowerLoopGains(K_ip=0.02, D_p=1500.0, K_iq=0.3, D_q=2.0)

_CONTROLLER = """
[[controllers]]
name = "fixed"
kind = "fixed"
"""

LCL = """
[converter]
S_rated = "5 kVA"
V_rated_rms = "110 V"
f_n = "50 Hz"
V_dc = "400 V"
f_sw = "10 kHz"
samples_per_carrier = 2
delay_samples = 1
modulation = "min_max"
[filter]
kind = "LCL"
L_1 = "2 mH"
R_1 = "50 mohm"
C = "20 uF"
R_c = "2 ohm"
L_2 = "0.5 mH"
R_2 = "20 mohm"
[inner_loops]
current_response_time = "1 ms"
voltage_response_time = "10 ms"
current_feedforward = 1.0
transient_resistance_pu = 0.0
[grid]
scr = 3
x_over_r = 2
"""


def lc_study(duration: str, events: str = "", sections: str = "", simulation: str = "", log: str = "50 us") -> Study:
    """The published case. ``sections`` overrides other tables, ``simulation`` adds lines to its table."""
    return study_from_text('base = "case:hoang2025_5kva"\n' + _rest(duration, events, sections, simulation, log))


def lcl_study(duration: str, events: str = "", simulation: str = "", log: str = "50 us", **replaced: str) -> Study:
    """An LCL converter with one sample of delay, min-max modulation and a damping resistor."""
    text = LCL
    for field, value in replaced.items():
        lines = [f"{field} = {value}" if line.startswith(f"{field} =") else line for line in text.splitlines()]
        text = "\n".join(lines) + "\n"
    return study_from_text(text + _rest(duration, events, "", simulation, log))


def _rest(duration: str, events: str, sections: str, simulation: str, log: str) -> str:
    return f"""{sections}
[simulation]
duration = "{duration}"
log_interval = "{log}"
P_ref = "2 kW"
Q_ref = "0.5 kvar"
{simulation}
{_CONTROLLER}
{events}
"""
