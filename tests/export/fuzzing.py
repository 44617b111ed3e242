"""Builds and runs the fuzzing program beside an exported folder, and judges what it wrote."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np

from tests.compilers import objects_of
from vsgdesign.artifacts import GainTable
from vsgdesign.equations.grid import grid_from_scr_impedance
from vsgdesign.equations.limiters import Limiter
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.export import initialiser
from vsgdesign.export.compiled import SOURCES, STRICT, run_compiler, sources_of
from vsgdesign.export.known_answers import gain_sizes, known_steps
from vsgdesign.runtime import Scheduler, table_schedule

# Not optimised: the sanitizers see the same faults, and optimising takes longer than the calls that it would hurry.
SANITIZERS = ("-g", "-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def build_fuzz(folder: Path, build: Path, *, double: bool, compiler: str = "gcc") -> Path:
    """The program, with sanitizers."""
    sources = [Path(__file__).with_name("fuzz.c"), *(folder / name for name in SOURCES)]
    return _linked(build / "fuzz", [compiler, *STRICT, *SANITIZERS], sources, [folder], double=double)


def _linked(program: Path, command: list[str], sources: list[Path], headers: list[Path], *, double: bool) -> Path:
    objects = objects_of([*command, *(["-DVSG_DOUBLE"] if double else [])], sources, headers)
    run_compiler([*command, *objects, "-o", str(program), "-lm"])
    return program


def build_control_fuzz(
    folder: Path, build: Path, scheduler: Scheduler, limiter: Limiter, *, double: bool, compiler: str = "gcc"
) -> Path:
    """The program that feeds the whole controller, its retune and its scheduler, with sanitizers."""
    known = known_steps(scheduler.lookup, scheduler.settings, limiter)
    lines = [
        f"#define FUZZ_INNER_GAINS {initialiser(known.inner_gains)}",
        f"#define FUZZ_REFERENCES {initialiser(known.refs)}",
        f"#define FUZZ_SETTINGS {initialiser(known.settings)}",
        f"#define FUZZ_V_PK {known.size.v_b_alpha!r}",
        f"#define FUZZ_I_PK {known.settings.i_max_pk / 1.2!r}",
    ]
    constants = known.settings.limiter
    if hasattr(constants, "V_low"):
        lines += ["#define FUZZ_V_BOX", f"#define FUZZ_V_LOW {constants.V_low!r}"]
        lines += [f"#define FUZZ_V_HIGH {constants.V_high!r}"]
    (build / "fuzz_settings.h").write_text("\n".join(lines) + "\n", encoding="utf-8")
    sources = [Path(__file__).with_name("fuzz_control.c"), *(folder / name for name in SOURCES)]
    command = [compiler, *STRICT, *SANITIZERS]
    return _linked(build / "fuzz_control", command, sources, [folder, build], double=double)


def build_converter_fuzz(folder: Path, build: Path, *, double: bool, compiler: str = "gcc") -> Path:
    """The program that feeds the converter with its field estimator, with sanitizers."""
    sources = [Path(__file__).with_name("fuzz_converter.c"), *sources_of(folder)]
    plain = [flag for flag in SANITIZERS if flag != "-g"]
    return _linked(build / "fuzz_converter", [compiler, *STRICT, *plain], sources, [folder], double=double)


def run_control_fuzz(program: Path, calls: int, seed: int) -> tuple[int, str]:
    """Exit code, and what it says."""
    done = subprocess.run([str(program), str(calls), str(seed)], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def run_fuzz(program: Path, calls: int, seed: int) -> tuple[int, str, np.ndarray]:
    """Exit code, what it says, and (N, 13): place, P, Q, V and gains of every answer."""
    answers = program.with_name("answers.bin")
    done = subprocess.run(
        [str(program), str(calls), str(seed), str(answers)], capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout + done.stderr, np.fromfile(answers).reshape(-1, 13)


def distance_from_table(table: GainTable, answers: np.ndarray) -> float:
    """The largest relative distance of the gains from those that the table's schedule has at their place and powers."""
    schedule = table_schedule(table)
    scr, r_over_x, P, Q, V = answers[:, :5].T
    R_g, L_g = grid_from_scr_impedance(scr, 1.0 / r_over_x, schedule.Z_base, schedule.omega)
    wanted = np.column_stack([np.broadcast_to(gain, scr.shape) for gain in schedule.gains_measured(R_g, L_g, P, Q, V)])
    pairs = np.abs(wanted)
    for a, b in ((0, 4), (2, 5), (6, 7)):
        pairs[:, [a, b]] = np.maximum(pairs[:, [a]], pairs[:, [b]])
    assert gain_sizes(PowerLoopGains(*wanted[0])) == tuple(pairs[0])
    error = np.abs(answers[:, 5:] - wanted)
    return float(np.max(np.where(error == 0.0, 0.0, error / np.where(pairs > 0.0, pairs, 1e-300))))
