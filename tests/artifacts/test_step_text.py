"""Certified steps in words: limits, units, rounding, and why there are none."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.gain_tables import table
from vsgdesign.artifacts.certificate_record import StepRow, StepStatement, step_statement
from vsgdesign.artifacts.gain_table_file import read_table_file, write_table_file
from vsgdesign.artifacts.table_text import STEP_HEAD, step_lines, step_rows, step_sentence
from vsgdesign.errors import ArtifactError
from vsgdesign.report.gain_table.page import steps_table
from vsgdesign.report.gain_table.words import heading

ROW = StepRow(
    scr=(2.0, 4.5),
    P=(-2000.0, 2000.0),
    Q=(0.0, 1000.0),
    rest_current_pu=0.6,
    proof="gap-free",
    P_ref=1239.9,
    Q_ref=1500.0,
    phase=math.radians(7.0),
    V_g=9.87654,
    omega_g=2.0 * math.pi * 0.12,
)
NONE = StepRow(scr=(4.5, 20.0), P=(-4500.0, 4500.0), Q=(-2000.0, 2000.0), rest_current_pu=1.19, proof="gridded")
FOUND = StepStatement(
    limiter="projection",
    current_pu=1.15,
    soft=True,
    V_low_pu=0.7,
    V_high_pu=1.3,
    clips_V=True,
    decay=0.6,
    P=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    proof="gap-free",
    rows=(ROW, NONE),
)


def test_a_row_has_its_units_and_is_rounded_down() -> None:
    shown = dict(zip(STEP_HEAD, step_rows(FOUND)[0], strict=True))
    assert shown == {
        "SCR": "2 to 4.5",
        "P [kW]": "±2",
        "Q [kvar]": "0 to 1",
        "P_ref [kW]": "1.23",
        "Q_ref [kvar]": "1.5",
        "phase [°]": "7",
        "V_g [V]": "9.87",
        "f_g [Hz]": "0.12",
        "proof": "gap-free",
    }


def test_where_no_step_is_possible_the_reason_is_said() -> None:
    assert step_rows(FOUND)[1][-2:] == ("none", "current at rest up to 1.19 pu")
    by_V = replace(FOUND, rows=(replace(NONE, rest_current_pu=0.5),))
    assert step_rows(by_V)[0][-1] == "V at rest reaches its limit"
    nowhere = replace(FOUND, rows=(replace(NONE, rest_current_pu=None),))
    assert step_rows(nowhere)[0][-1] == "no operating point"


def test_the_sentence_names_the_limits() -> None:
    assert step_sentence(FOUND).startswith(
        'The current limiter "projection" begins to act at 1.15 pu, its soft limit, and it clips V at 0.7 and 1.3 pu. '
    )
    circular = replace(FOUND, limiter="circular", soft=False, V_low_pu=None, V_high_pu=None, clips_V=False)
    assert (
        "begins to act at 1.15 pu, its limit. In the linear model with ideal inner loops, it is certified that no"
        in step_sentence(circular)
    )
    assert "gridded" not in step_sentence(FOUND)  # a row without steps is not graded
    some = replace(FOUND, rows=(replace(ROW, proof="gridded"),))
    assert step_sentence(some).endswith(
        'A "gridded" row is verified at points, with a margin of 20 %, and not between them.'
    )
    free = replace(FOUND, current_pu=None, soft=False)
    assert step_sentence(free).startswith("The converter has no current limit, so no limit acts after any step.")
    without = replace(FOUND, rows=(), reason="no common function was found")
    assert step_lines(without) == [step_sentence(without)]
    assert step_sentence(without).endswith("No step is certified, because no common function was found.")


def test_a_table_keeps_its_steps_and_its_page_and_overview_show_them(tmp_path) -> None:
    made = table(certificate={"certified": True, "decay": 2.0, "steps": FOUND.as_document()})
    write_table_file(made, tmp_path / "table.json")
    read = read_table_file(tmp_path / "table.json")
    assert read.certificate is not None
    assert read.certificate.steps == FOUND == step_statement(FOUND.as_document())
    page = steps_table(read)
    assert page is not None
    assert list(page.rows) == step_rows(FOUND)
    assert set(step_lines(FOUND)) <= set(heading(read))
    # A table of before has none.
    assert steps_table(table(certificate={"decay": 2.0})) is None


@pytest.mark.parametrize(
    "spoiled",
    [
        {"rows": [{"scr": [1.0, 2.0]}]},
        {"rows": [vars(ROW) | {"phase": "wide"}]},
        {"rows": [vars(ROW) | {"scr": [1.0]}]},
        {"rows": None},
        {"P": [["x"]]},
        {"soft": "yes"},
        {"unknown": 1.0},
    ],
)
def test_a_damaged_statement_is_refused_by_name(spoiled: dict[str, object]) -> None:
    with pytest.raises((ValueError, ArtifactError), match=r"certificate\.steps: is not what certify writes"):
        table(certificate={"decay": 2.0, "steps": FOUND.as_document() | spoiled})
