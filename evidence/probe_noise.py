"""How far P and Q move at rest, because of the field estimator's probe and without it.

Three converters, switched, with sensors in the loop, in the background that was measured but without its wander: the
standard deviation of the mean over two cycles, at the PCC, with every sample. Pair 1 are the lines that the probe has.
The others are those of further converters on one grid.
``VSGDESIGN_FIELD_SHARE=0.5`` measures half of the draws.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from evidence._field_converters import Converter, converter_named
from evidence._kept_runs import EVIDENCE_SEED, share
from evidence._tables import leave, table
from evidence.field_scenario import ToldTheTruth
from vsgdesign.identification.field import PAIRS as LINES
from vsgdesign.metrics import cycle_mean
from vsgdesign.simulation import simulate
from vsgdesign.simulation.every_sample import signals_at_pcc
from vsgdesign.simulation.field_feed import FieldScheduler, with_pair
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.background import draw_background
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.sensors import draw_sensors
from vsgdesign.study.parameters.study import Study

FIELD = Path(__file__).resolve().parents[1] / "studies" / "field" / "study.toml"
CONVERTERS = {"5 kVA": 1.0, "12.5 kVA": 2.0, "1 MVA": 2.0}
"""X/R of the grid."""
POWERS_PU = {2.0: (0.4, 0.2), 8.0: (0.5, 0.2), 20.0: (0.6, 0.2)}
"""P and Q by SCR."""
PAIRS = len(LINES)
DRAWS, REST_FROM_S, DURATION_S = 4, 6.0, 26.0

_STILL = (
    *("frequency_wander", "frequency_deviation", "voltage_wander", "voltage_deviation"),
    *("phase_noise", "voltage_noise", "voltage_steps_per_minute"),
)


def converter_of(name: str) -> Converter:
    """A converter of the evidence; that of 5 kVA as the field study has it."""
    if name != "5 kVA":
        return converter_named(name)
    study = load_study(FIELD)
    return Converter(name, study, next(one for one in study.controllers if one.estimate == "field"))


def at_rest(converter: Converter, scr: float, seed: int, duration_s: float = DURATION_S) -> Study:
    """Nothing happens, on a grid whose background and sensors are drawn."""
    study, c = converter.study, converter.study.converter
    P, Q = (part * c.S_rated for part in POWERS_PU[scr])
    ranges = dict.fromkeys(_STILL, (0.0, 0.0)) | {"voltage_factor": (1.0, 1.0)}
    return replace(
        study,
        grid=Place(scr, CONVERTERS[converter.name], "impedance").grid(c),
        events=(),
        background=draw_background(ranges, seed, "measured"),
        sensors=draw_sensors({}, seed, "typical"),
        simulation=replace(study.simulation, duration=duration_s, log_interval=c.T_s, P_ref=P, Q_ref=Q),
    )


def noise_of(
    converter: Converter, study: Study, *, probe: bool = True, from_s: float = REST_FROM_S
) -> dict[str, float]:
    """Standard deviation of the two-cycle means of P and Q, % of the rating, the share of valid answers, and the median
    of the deviation of Z that they state, %."""
    c = study.converter
    follows = FieldScheduler if probe else ToldTheTruth
    scheduler = follows(study, replace(converter.spec, estimate="field"), probe=probe)
    seen = signals_at_pcc(study, simulate(study, scheduler).to_its_end())
    samples = round(4.0 * math.pi / c.omega_n / c.T_s)
    rows = seen.t_s > from_s
    said = [row.answer for row in scheduler.rows if row.t_s > from_s]
    sigma = sorted(one.sigma for one in said)
    return {
        "P_pct": 100.0 * float(cycle_mean(seen.P_pcc, samples)[rows].std()) / c.S_rated,
        "Q_pct": 100.0 * float(cycle_mean(seen.Q_pcc, samples)[rows].std()) / c.S_rated,
        "valid": sum(one.valid for one in said) / len(said),
        "sigma_pct": 100.0 * sigma[len(sigma) // 2],
    }


def of_pair(pair: int, draws: int) -> list[dict[str, Any]]:
    """Every converter, SCR and draw with a pair of lines; pair 0 sends none, and pairs beyond the first are run on the
    strongest grid alone."""
    found = []
    for name in CONVERTERS:
        converter = converter_of(name)
        for scr in POWERS_PU if pair < 2 else (max(POWERS_PU),):
            for seed in range(EVIDENCE_SEED, EVIDENCE_SEED + draws):
                study = with_pair(at_rest(converter, scr, seed), max(pair, 1))
                figures = noise_of(converter, study, probe=pair > 0)
                found.append({"pair": pair, "converter": name, "scr": scr, "seed": seed} | figures)
    return found


def main(folder: Path) -> None:
    draws = max(round(share() * DRAWS), 1)
    rows: list[dict[str, Any]] = []
    for pair in range(PAIRS + 1):
        rows += of_pair(pair, draws)
    head = ["converter", "SCR", "no probe: P, Q", *(f"pair {pair}: P, Q; sigma of Z" for pair in range(1, PAIRS + 1))]
    cells = []
    for name in CONVERTERS:
        for scr in POWERS_PU:
            shown = []
            for pair in range(PAIRS + 1):
                mine = [r for r in rows if (r["pair"], r["converter"], r["scr"]) == (pair, name, scr)]
                if not mine:
                    shown.append("–")
                    continue
                P, Q = (_rms([row[key] for row in mine]) for key in ("P_pct", "Q_pct"))
                sigma = f"; {_rms([row['sigma_pct'] for row in mine]):.1f} %" if pair else ""
                shown.append(f"{P:.3f}, {Q:.3f}{sigma}")
            cells.append([name, f"{scr:g}", *shown])
    words = f"Rms over {draws} draws of background and sensors, in % of the rating."
    leave(folder, "probe_noise", rows, [words, "", *table(head, cells)])


def _rms(values: list[float]) -> float:
    return math.sqrt(sum(value * value for value in values) / len(values))
