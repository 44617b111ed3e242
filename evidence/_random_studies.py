"""Random legal studies: five cases, both bridges, closed forms and tables, pairs of events, odd logs, odd starts."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vsgdesign.artifacts import GainTable, ValidityBox, write_table_file
from vsgdesign.artifacts.gain_table import base_of
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.runtime.table import with_node_gains
from vsgdesign.study.parameters import Study, study_from_text

INNER = 'inner_loops = {{ current_response_time = "{}", voltage_response_time = "5 ms", current_feedforward = {} }}'
CASES = {
    "hoang2025_5kva": "",
    "lab_12kva_lcl": "",
    "utility_1mva_60hz": "",
    "motulator_10kva_lcl": INNER.format("2 ms", 0),
    "simplus_100kva": INNER.format("1 ms", 0.7),
}
"""Converters, and the inner loops of those that have none of their own."""
STRUCTURES = ("published", "decoupled", "angle_damped")
DURATION_S = 1.6
SETTLING_S = 0.4
"""Short, so that most windows are long enough to be measured."""


def bare(case: str) -> Study:
    """A case without anything that happens."""
    return study_from_text(
        f'base = "case:{case}"\n{CASES[case]}\nsimulation = {{ duration = 0.1, P_ref = 0, Q_ref = 0 }}\n'
        'controllers = [{ name = "a", kind = "fixed" }]'
    )


def table_of(study: Study, name: str, path: Path) -> None:
    """A table of constant poles for grids of SCR 3 to 8, as a file."""
    shape, S, V = (3, 3), study.converter.S_rated, study.converter.V_rated_rms
    poles = {"k_1": 21.3 / SETTLING_S**2, "d_1": 8.24 / SETTLING_S, "k_2": 3.91 / SETTLING_S, "q": 0.0}
    made = GainTable(
        name=name,
        structure="angle_damped",
        law="poles",
        study=study.name,
        study_hash=study.hash,
        base=base_of(study, "impedance"),
        D_p=S / (0.05 * study.converter.omega_n),
        D_q=S / (0.5 * V),
        P_design=0.5 * S,
        Q_design=0.0,
        time_scale=1.0,
        scr=np.array([3.0, 5.0, 8.0]),
        x_over_r=np.array([1.0, 3.0, 6.0]),
        columns={key: np.full(shape, value) for key, value in (poles | {"share_P": 1.0, "share_Q": 1.0}).items()},
        gains=PowerLoopGains(*[np.full(shape, np.nan)] * 8),
        status=np.full(shape, "met"),
        active=np.full(shape, ""),
        price=np.zeros(shape),
        validity=ValidityBox((3.0, 8.0), (1.0, 6.0), (-0.5 * S, 0.5 * S), (-0.3 * S, 0.3 * S), (0.9 * V, 1.1 * V), 0.0),
    )
    write_table_file(with_node_gains(made), path)


def drawn_study(rng: np.random.Generator, folder: Path, name: str) -> str:
    """A legal study as text; its table, if it has one, is written to the folder. The spacing of the log is left open:
    ``{log}`` stands for it."""
    case = str(rng.choice(list(CASES)))
    study = bare(case)
    S, f_n = study.converter.S_rated, study.converter.omega_n / (2.0 * np.pi)
    structure = str(rng.choice(STRUCTURES, p=[0.2, 0.3, 0.5]))
    by_table = structure == "angle_damped" and rng.random() < 0.5
    outside = by_table and rng.random() < 0.5
    scr = rng.uniform(9.0, 14.0) if outside else rng.uniform(3.0, 8.0)
    target = "" if by_table else f', settling_time = "{SETTLING_S} s"'
    bridge, survival = rng.choice(["averaged", "averaged", "averaged", "pwm"]), rng.choice(["true", "false"])
    lines = [
        f'base = "case:{case}"',
        f'study = {{ name = "{name}" }}',
        CASES[case],
        f'grid = {{ scr_basis = "impedance", scr = {scr:.4f}, x_over_r = {rng.uniform(1.0, 6.0):.4f} }}',
        f"power_loops = {{ P_droop = {rng.choice([0.02, 0.05])}, Q_droop = {rng.choice([0.05, 0.5])} }}",
        f"simulation = {{ duration = {DURATION_S}, P_ref = {rng.uniform(-0.4, 0.4) * S:.5g}, "
        f'Q_ref = {rng.uniform(-0.1, 0.1) * S:.5g}, bridge = "{bridge}", survival = {survival}, {{log}} }}',
        "[[controllers]]",
        'name = "a"',
        f'kind = "{"scheduled" if by_table or rng.random() < 0.4 else "fixed"}"',
        f'structure = "{structure}"{target}'.replace(", ", "\n"),
    ]
    if by_table:
        table_of(study, "a", folder / f"{name}.table.json")
        lines += ['schedule = "table"', f'table = "{folder / f"{name}.table.json"}"']
    if rng.random() < 0.3:
        lines += ["current_limit_pu = 1.2", f'current_limiter = "{rng.choice(["circular", "projection"])}"']
    first = rng.uniform(0.02, 0.1)
    for t_s in (first, first + float(rng.choice([0.003, 0.02, 0.4]))):
        change = [
            f"P_ref = {rng.uniform(-0.5, 0.5) * S:.5g}",
            f"Q_ref = {rng.uniform(-0.2, 0.2) * S:.5g}",
            f"grid = {{ scr = {rng.uniform(2.5, 10.0):.4f} }}",
            f"V_g_pu = {rng.uniform(0.93, 1.05):.4f}",
            f"phase_jump = {rng.uniform(-0.5, 0.5):.4f}",
            f"f_g = {f_n * rng.uniform(0.998, 1.002):.5f}",
            f"V_g_pu = {rng.uniform(0.93, 1.05):.4f}\nover = 0.05",
        ]
        lines += ["[[events]]", f"time = {t_s:.8f}", str(rng.choice(change))]
    return "\n".join(lines)


def odd_log(rng: np.random.Generator, T_s: float) -> str:
    """Fields of [simulation] that say a spacing which no figure may depend on."""
    every = int(rng.choice([2, 7, 61, 499, 4999]))
    return f"log_interval = {every * T_s!r}, csv_interval = {rng.choice([0.0, 0.0103, 0.5])}"
