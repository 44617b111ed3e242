"""The full-order model as a block: the matrices and the period that CasADi computes, operation by operation."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tests.codegen.plain_blocks import Plain
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.model.compiled import block_of, model_names
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.study.parameters import study_from_text

STUDY = """
base = "case:lab_12kva_lcl"
grid = { scr = 3, x_over_r = 4 }
converter = { current_limit_pu = 1.2, current_limiter = "LIMITER" }
simulation = { duration = 1.0, P_ref = "4 kW", Q_ref = 0 }
[[controllers]]
name = "fixed"
kind = "fixed"
"""


@pytest.mark.parametrize("limiter", ["circular", "projection"])
def test_the_block_has_the_numbers_of_casadi(limiter: str) -> None:
    study = study_from_text(STUDY.replace("LIMITER", limiter))
    gains = PowerLoopGains(K_ip=2e-3, D_p=800.0, K_iq=2e-2, D_q=100.0)
    model = linearise_full_order(study, [Cell(study.grid, gains, 4e3, 0.0)])
    z, p = model_names(model.map)
    given = dict(zip((*z, *p), (*model.z[0], *model.p[0]), strict=True))
    function = model.map.linear
    outputs = [[f"{letter}{k}" for k in range(function.numel_out(at))] for at, letter in enumerate("ABCD")]
    said = Plain(block_of(function, (z, p), outputs))(given)
    for names, matrix in zip(outputs, (model.A, model.B, model.C, model.D), strict=True):
        found = np.array([said[name] for name in names]).reshape(matrix[0].T.shape).T
        np.testing.assert_allclose(found, matrix[0], rtol=1e-12, atol=1e-12 * np.abs(matrix[0]).max())


def test_logic_and_signs_are_numbers() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    results = [
        ca.if_else(x > y, x, -y), ca.sign(x), ca.logic_and(x > 0, y > 0), ca.logic_or(x > 0, y > 0), ca.logic_not(x),
        ca.fmin(x, y), ca.atan2(x, y), ca.exp(x), 1 / y, 2 * x, ca.floor(y), ca.fabs(x),
    ]  # fmt: skip
    function = ca.Function("several", [x, y], [ca.vertcat(*results)])
    plain = Plain(block_of(function, (["x"], ["y"]), [[str(k) for k in range(len(results))]]))
    for at in ((0.5, 2.0), (-1.5, 0.25), (0.0, -3.0), (2.0, 2.0)):
        said = plain({"x": at[0], "y": at[1]})
        theirs = np.array(function(*at)).ravel()
        np.testing.assert_allclose([said[str(k)] for k in range(len(results))], theirs, rtol=1e-14)


def test_an_operation_that_blocks_do_not_have_is_told() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match="blocks have no such operation"):
        block_of(ca.Function("erf", [x], [ca.erf(x)]), (["x"],), [["y"]])
