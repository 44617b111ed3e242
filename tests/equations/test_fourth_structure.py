"""A structure that only this file knows goes through every room: nothing else has to be touched to add one."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.compilers import require_compiler
from tests.design.robust_studies import robust_study, scenarios, specification
from tests.export.exchange import compare, random_calls
from tests.gain_tables import table
from vsgdesign.artifacts import read_table_file, write_table_file
from vsgdesign.certificate import Certificate, Region, certify
from vsgdesign.design.cell import common_design, design_cell
from vsgdesign.design.evaluation import law_of
from vsgdesign.design.single import best_fixed
from vsgdesign.design.study_design import design_closed_form
from vsgdesign.equations.power_flow import jacobian_from_powers
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import PUBLISHED, STRUCTURES, NormalisedGains, Structure, placed_closed_form
from vsgdesign.errors import ArtifactError, StudyError, UnknownNameError
from vsgdesign.export import compile_c, export_c_files
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.linear.stability.margins import full_order_margins
from vsgdesign.metrics import step_response
from vsgdesign.report.gain_table.words import heading
from vsgdesign.runtime import load_scheduler, table_schedule
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.study.parameters import Event, Study, study_from_text

ROOT = Path(__file__).resolve().parents[2]


def diagonal_gains(
    A: Any,
    B: Any,  # noqa: ARG001
    C: Any,  # noqa: ARG001
    D: Any,
    normalised: NormalisedGains,
    D_p: Any,
    D_q: Any,
    S_rated: Any,  # noqa: ARG001
    omega_0: Any,  # noqa: ARG001
    by_inertia: bool,  # noqa: ARG001
) -> PowerLoopGains:
    """The paper's diagonal, with droops that are free and damping through the angle."""
    K_ip = normalised.k_1_or_H / A
    k_P = (normalised.d_1_or_zeta - K_ip * D_p) / A
    return PowerLoopGains(K_ip, D_p, normalised.k_2 / (D + D_q), D_q, 0.0, 0.0, k_P, 0.0)


DIAGONAL = Structure(
    name="damped_diagonal",
    gains=diagonal_gains,
    closed_form=placed_closed_form,
    free=(),
    tuned=("K_ip", "K_iq", "k_P"),
    start_share=0.0,
    P_droop=True,
    Q_droop=True,
)

TEXT = """
base = "studies/structures/study.toml"
study = { name = "fourth", title = "A fourth structure" }
[grid]
scr = 5
x_over_r = 5
[[controllers]]
name = "diagonal"
kind = "scheduled"
structure = "damped_diagonal"
"""


@pytest.fixture(autouse=True)
def _registered() -> Iterator[None]:
    forget = STRUCTURES.register(DIAGONAL)
    yield
    forget()
    assert DIAGONAL.name not in STRUCTURES


def fourth() -> Study:
    return study_from_text(TEXT, folder=ROOT)


def test_a_study_names_it_and_an_unknown_name_is_told_with_all_that_are_known() -> None:
    spec = fourth().controllers[0]
    assert spec.target.structure == "damped_diagonal"
    assert spec.target.follow_references  # as every structure that does not say otherwise
    with pytest.raises(StudyError, match=r"structure = .fifth.: must be one of .*published.*damped_diagonal"):
        study_from_text(TEXT.replace("damped_diagonal", "fifth"), folder=ROOT)


def test_no_name_is_taken_for_another_one() -> None:
    unknown = "structure = 'fifth': must be one of published, decoupled, angle_damped, fast_voltage, damped_diagonal."
    with pytest.raises(UnknownNameError) as caught:
        STRUCTURES["fifth"]
    assert str(caught.value) == unknown
    assert STRUCTURES.get("fifth") is None
    with pytest.raises(UnknownNameError):
        replace(table_schedule(table()), structure="fifth").gains(0.1, 1e-3)
    with pytest.raises(ValueError, match=r"'published' is already the name of another structure"):
        STRUCTURES.register(replace(DIAGONAL, name="published"))
    assert STRUCTURES["published"] is PUBLISHED
    STRUCTURES.register(DIAGONAL)  # the same again is no fault


@pytest.mark.parametrize("wrong", [{"name": "a b"}, {"tuned": ("K_pi",)}, {"free": (("k_2", 0.0, 1.0, False),)}])
def test_a_structure_that_cannot_be_one_is_refused(wrong: dict[str, Any]) -> None:
    if "free" in wrong:
        wrong = {"free": tuple(type(PUBLISHED.free[0])(*entry) for entry in wrong["free"])}
    with pytest.raises(ValueError, match=next(iter(wrong))):
        replace(DIAGONAL, **wrong)


def test_other_processes_are_told_of_it() -> None:
    assert STRUCTURES.added == (DIAGONAL,)
    assert pickle.loads(pickle.dumps(DIAGONAL)) == DIAGONAL  # noqa: S301 - what a pool of processes does


def test_a_closed_form_has_its_poles_and_the_studys_droops() -> None:
    study = fourth()
    design = design_closed_form(study, study.controllers[0], study.grid)
    A, _, _, D = jacobian_from_powers(
        design.point.P, design.point.Q, design.point.V_rms, *study.path_to_grid(study.grid)
    )
    gains, target, c = design.gains, study.controllers[0].target, study.converter
    assert gains.K_ip * A == pytest.approx(target.k_1, rel=1e-12)
    assert gains.K_iq * (D + gains.D_q) == pytest.approx(target.k_2, rel=1e-12)
    assert gains.k_P * A + gains.K_ip * gains.D_p == pytest.approx(target.d_1, rel=1e-12)
    assert gains.D_p == pytest.approx(c.S_rated / (target.P_droop * c.omega_n), rel=1e-12)
    margins = full_order_margins(linearise_full_order(study, [Cell(study.grid, gains, target.P, target.Q)]))
    assert margins.stable.all()
    assert margins.disk_output.value[0] > 0.5


def test_the_emt_settles_on_a_step() -> None:
    """Coupling is left in, so no second is promised: 2 s at SCR 5 and X/R 5 with the poles of 1 s."""
    study = fourth()
    rest = 2000.0
    spec = replace(study.simulation, duration=3.0, P_ref=rest, Q_ref=0.0, log_interval=500e-6)
    target = replace(study.controllers[0].target, P=rest, Q=0.0)
    gains = design_closed_form(study, replace(study.controllers[0], target=target), study.grid).gains
    study = replace(study, simulation=spec, events=(Event(0.2, "step", P_ref=rest + 250.0),))
    run = simulate(study, [GainChange(0.0, gains)])
    y, after = run.column("P"), run.t_s >= 0.2
    found = step_response(run.t_s[after] - 0.2, y[after], float(y[~after][-1]), float(y[-1]))
    assert found.final == pytest.approx(rest + 250.0, abs=5.0)
    assert found.settling_time_s is not None
    assert found.settling_time_s < 2.0


def test_a_cell_is_designed_and_a_single_tuning_is_found() -> None:
    study = robust_study()
    spec, target = specification(study), replace(study.controllers[0].target, structure=DIAGONAL.name)
    law = law_of(study, target, spec.aim)
    box = scenarios(study, 6.0, 3.0)
    design = design_cell(law, spec, box, common_design(law, spec, [box]))
    assert design.met
    assert (design.normalised.q, design.normalised.share_P, design.normalised.share_Q) == (0.0, 0.0, 0.0)
    fixed = best_fixed(study, target, [(6.0, 3.0)], population=8, generations=4)
    assert fixed.structure == DIAGONAL.name
    assert fixed.gains.K_pq == fixed.gains.K_qp == fixed.gains.k_Q == 0.0
    assert fixed.gains.D_p == pytest.approx(law.D_p)


def test_its_decay_is_proved_without_gaps() -> None:
    """The certificate traces the gains as they are written: nothing in it knows of this structure."""
    study = fourth()
    region = Region((4.0, 8.0), (4.0, 10.0), (0.0, 2500.0), (-500.0, 500.0), 0.1)
    found = certify(study, study.controllers[0], region, fresh=2000, nodes_per_axis=5)
    assert isinstance(found, Certificate)
    assert found.proof == "gap-free"
    assert 0.5 < found.decay < study.controllers[0].target.d_1 / 2.0


def test_a_table_of_it_is_written_read_and_scheduled(tmp_path: Path) -> None:
    made = table(DIAGONAL.name, D_p=318.3, parameters={"share_P": 0.0, "share_Q": 0.0})
    write_table_file(made, tmp_path / "table.json")
    read = read_table_file(tmp_path / "table.json")
    gains = table_schedule(read).gains(0.5, 5e-3)
    assert gains.D_p == 318.3
    assert gains.k_P > 0.0
    assert np.array_equal(read.gains.K_ip, made.gains.K_ip, equal_nan=True)
    assert "droop: D_p = 318.3 W·s/rad, D_q = 90.9 var/V" in list(heading(read))
    text = (tmp_path / "table.json").read_text(encoding="utf-8")
    (tmp_path / "other.json").write_text(text.replace(DIAGONAL.name, "fifth_structure"), encoding="utf-8")
    with pytest.raises(ArtifactError):
        read_table_file(tmp_path / "other.json")


def test_the_exported_c_has_its_gains(tmp_path: Path) -> None:
    """From the function above, read by its syntax tree; compiled, and called like the scheduler in Python."""
    require_compiler("cc")
    changes = {"D_p": 318.3, "parameters": {"share_P": 0.0, "share_Q": 0.0}}
    write_table_file(table(DIAGONAL.name, **changes), tmp_path / "table.json")
    compiled = compile_c(export_c_files(tmp_path / "table.json", tmp_path / "c").folder, double=True)
    scheduler = load_scheduler(tmp_path / "table.json")
    difference = compare(scheduler, compiled, random_calls(scheduler, 300, seed=1))
    assert difference.statuses == 0
    assert difference.fresh > 100
    assert difference.gains <= 1e-12
    assert "diagonal_gains" in "".join(path.read_text(encoding="utf-8") for path in (tmp_path / "c").glob("*.[ch]"))
