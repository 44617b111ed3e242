"""What a page says of a network and of the errors of an estimate."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from tests.artifacts.networks import random_weights
from vsgdesign.metrics.answers import ChangeSeen, RestError
from vsgdesign.report.scenario.estimate_tables import network_table, worst_text


@pytest.mark.parametrize(("file", "carried"), [("mine.json", True), ("", False)])
def test_what_a_file_of_weights_states_alone_is_marked(file: str, carried: bool) -> None:
    study = SimpleNamespace(estimator=SimpleNamespace(weights_file=file))
    result: Any = SimpleNamespace(study=study, ready=SimpleNamespace(network=random_weights()))
    assert any(row[0] == "Carried, not checked" for row in network_table(result, None).rows) is carried


def test_the_worst_single_answer_is_said_beside_the_mean() -> None:
    rest = RestError(
        begin_s=1.0, end_s=2.0, R_g=1.0, L_g=1e-3, R_mean_pct=1.0, L_mean_pct=-2.0, R_worst_pct=3.0, L_worst_pct=22.0
    )
    judged: Any = SimpleNamespace(rest=(rest,), changes=(ChangeSeen(1.0, 1, None, 61.0),))
    assert (
        worst_text(judged)
        == " A single answer is off by up to 22 % at rest and by up to 61 % after a change of the grid."
    )
    nothing: Any = SimpleNamespace(rest=(), changes=())
    assert worst_text(nothing) == ""
