"""The energy balance of 60 s on a battery: averaged and switched bridge, with and without compensation of the link.

∫p_src − ∫p_grid − losses − ΔW of the 5 kVA converter of the tests, over a step of the power and a sag, from an
integration of every sample of its own (tests/oracles/dc_energy.py).
"""

from __future__ import annotations

from pathlib import Path

from evidence._tables import leave, table
from tests.oracles.dc_energy import energies
from tests.simulation.studies import GAINS, lcl_study
from vsgdesign.equations.controller import ControllerState
from vsgdesign.simulation import GainChange, simulate

EVENTS = """
[[events]]
time = "6 s"
P_ref = "2.6 kW"
[[events]]
time = "30 s"
V_g_pu = 0.9
[[events]]
time = "36 s"
V_g_pu = 1.0
[dc]
source = "battery"
C = "500 uF"
R_bleed = "20 kohm"
[dc.battery]
R_i = "0.4 ohm"
i_max = 30
capacity_Ah = 5
charge = 0.61
"""


def main(folder: Path) -> None:
    document = {}
    columns = [ControllerState._fields.index(name) for name in ("u_alpha", "u_beta")]
    for bridge in ("averaged", "pwm"):
        for compensation in ("measured", "none"):
            study = lcl_study("60 s", EVENTS).with_changes(dc={"compensation": compensation})
            run = simulate(study, [GainChange(0.0, GAINS)], log_states=10**9, bridge=bridge)
            found = energies(study, run, run.controller_log[:, columns].copy(), pwm=bridge == "pwm")
            left = found.grid + found.lost + found.stored
            document[f"{bridge}, {compensation}"] = {
                "given": found.given - left,
                "source": found.source - left,
                "grid": found.grid,
            }
            print(bridge, compensation, document[f"{bridge}, {compensation}"], flush=True)
            del run
    head = ["bridge, compensation", "by the sums of the run, J", "by the battery's own law, J", "into the grid, J"]
    rows = [
        [name, f"{one['given']:.1e}", f"{one['source']:.1e}", f"{one['grid']:,.0f}"] for name, one in document.items()
    ]
    leave(folder, "dc_energy", document, table(head, rows))
