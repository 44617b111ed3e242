"""CasADi's functions as lists of operations, against CasADi itself: bit for bit."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tests.design.robust_studies import law, robust_study, scenarios, specification
from vsgdesign.codegen.operation_list import LANES
from vsgdesign.design import nlp
from vsgdesign.linear.model.compiled import InLanes, list_of
from vsgdesign.linear.model.coupled import coupled_function


def everything() -> ca.Function:
    """A function with each operation that CasADi has in an expression, and a constant, an input and a zero as
    results."""
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    a, b = x[0], x[1]
    of_one = (ca.sin, ca.cos, ca.tan, ca.asin, ca.acos, ca.atan, ca.sinh, ca.cosh, ca.tanh, ca.asinh, ca.atanh)
    others = (ca.exp, ca.expm1, ca.log1p, ca.floor, ca.ceil, ca.fabs, ca.sign, ca.erf)
    two = (ca.atan2, ca.fmin, ca.fmax, ca.fmod, ca.hypot, ca.copysign)
    found = [of(a) for of in (*of_one, *others)] + [of(a, b) for of in two]
    found += [
        ca.acosh(1.0 + y),
        ca.log(y),
        ca.sqrt(y),
        y**2.3,
        y**b,
        a * a,
        2.0 * a,
        1.0 / a,
        -a,
        a + b,
        a - b,
        a / b,
        3.7 * b,
    ]
    found += [ca.if_else(a < b, a, y), a <= b, ca.eq(a, b), ca.ne(a, b), ca.logic_and(a, y), ca.logic_or(a, 0 * y)]
    found += [ca.logic_not(a < b), 4.25, ca.SX(0.0), y]
    return ca.Function("everything", [x, y], [ca.vertcat(*found), ca.horzcat(a, y)])


def test_every_operation_has_the_bits_of_casadi() -> None:
    function, rng = everything(), np.random.default_rng(3)
    listed = list_of(function)
    inputs = np.vstack([rng.uniform(-0.9, 0.9, size=(2, LANES)), rng.uniform(0.1, 3.0, size=(1, LANES))])
    found = listed.run(inputs)
    for lane, (a, b, y) in enumerate(inputs.T):
        expected = np.concatenate([np.array(one.nonzeros()) for one in function([a, b], y)])
        np.testing.assert_array_equal(found[:, lane], expected)
        assert np.isfinite(expected).all()


def test_what_a_list_has_not_is_refused() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match="no operation erfinv"):
        list_of(ca.Function("f", [x], [ca.erfinv(x)]))


@pytest.mark.parametrize("yields", [False, True])
def test_the_coupled_model_has_the_bits_of_casadi(yields: bool) -> None:
    function, rng = coupled_function(True, True, yields=yields), np.random.default_rng(4)
    listed = list_of(function)
    inputs = rng.uniform(0.2, 2.0, size=(listed.inputs, LANES))
    found = listed.run(inputs)
    for lane, given in enumerate(inputs.T):
        expected = np.concatenate([np.array(one.nonzeros()) for one in function(*given)])
        np.testing.assert_array_equal(found[:, lane], expected)


def test_columns_side_by_side_are_those_of_casadi_one_by_one() -> None:
    """Rows and slopes of a design, with the rule of chains as CasADi takes it through a call."""
    study = robust_study()
    spec, rule = specification(study), law(study, "angle_damped")
    variables = nlp.variables("angle_damped", spec)
    slot, count = nlp._slot_function(rule, spec, variables), len(variables.names)
    rows, slopes = nlp._of_all_slots(slot, count)
    box = scenarios(study, 3.0, 1.0)
    columns = np.array([getattr(box, name)[: nlp.SLOTS] for name in type(box).__dataclass_fields__])
    x = np.concatenate([np.linspace(-0.2, 0.3, count), [0.4], 0.1 * np.ones(len(nlp.KINDS)), [0.5]])
    X, P = ca.MX.sym("X", len(x)), ca.MX.sym("P", *columns.shape)
    mapped = slot.map(nlp.SLOTS)(
        *(ca.repmat(one, 1, nlp.SLOTS) for one in (X[:count], X[count], X[count + 1 : -1], X[-1])), P
    )
    casadi = ca.Function("casadi", [X, P], [ca.vec(mapped), ca.jacobian(ca.vec(mapped), X)])
    expected_rows, expected_slopes = casadi(x, columns)
    np.testing.assert_array_equal(rows(x, columns).full(), expected_rows.full())
    found = slopes(x, columns)
    assert found.sparsity() == expected_slopes.sparsity()
    np.testing.assert_array_equal(found.full(), expected_slopes.full())


def test_a_last_input_and_fewer_columns_than_lanes() -> None:
    x, column, last = ca.SX.sym("x"), ca.SX.sym("c", 2), ca.SX.sym("last", 2)
    one = ca.Function("one", [x, column, last], [ca.vertcat(x + column[0], last[0] * column[1], last[1])])
    found = InLanes(one, 3, [10.0, 7.0])(0.5, np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]))
    np.testing.assert_array_equal(found.full().ravel(), [1.5, 40.0, 7.0, 2.5, 50.0, 7.0, 3.5, 60.0, 7.0])
