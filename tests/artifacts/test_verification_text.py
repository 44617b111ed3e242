"""The sentences of a verification: right counts, and nothing is promised that the bound does not carry."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tests.verification_documents import document
from vsgdesign.artifacts.verification_text import (
    bound_text,
    headline,
    kept,
    promise_sentence,
    promise_sentences,
    share_text,
    worst_text,
)
from vsgdesign.campaigns.verification.document import one_in as one_in_of


def promise(broken: int, judged: int, **changes: Any) -> dict[str, Any]:
    """A promise without a broken case has the closed form 1 − (1 − c)^(1/n) as its bound."""
    bound = None if judged == 0 else -math.expm1(math.log(0.01) / judged)
    found = {"figure": "overshoot", "limit": 0.05, "broken": broken, "judged": judged, "bound": bound} | changes
    one_in = None if found["bound"] is None else one_in_of(found["bound"])
    return {"share": broken / judged if judged else None, "one_in": one_in} | found


def test_the_sentence_of_a_promise_that_holds() -> None:
    said = promise_sentence("step", {}, "overshoot", promise(0, 48211), 0.99)
    assert said == "Overshoot: 0 of 48,211 steps above 5 %; with 99 % confidence fewer than 1 in 10,400 would be."
    said = promise_sentence("step", {"noun": "steps of P"}, "overshoot", promise(0, 100_000), 0.99)
    assert said.endswith("fewer than 1 in 21,700 would be.")


def test_the_sentence_of_a_promise_that_is_broken() -> None:
    survival = promise(2, 2000, figure="recovery_s", survival=True, limit=2.8, bound=0.00419)
    assert promise_sentence("grid", {}, "survival", survival, 0.999) == (
        "Survival: 2 of 2,000 jumps of the grid not at rest in 2.8 s (0.1 %); with 99.9 % confidence fewer than 1 in "
        "238 would be."
    )
    current = promise(30, 40, figure="peak_pu", limit=1.32, bound=0.8811)
    said = promise_sentence("grid", {}, "current", current, 0.95)
    assert said == (
        "Peak current: 30 of 40 jumps of the grid above 1.32 pu (75 %); with 95 % confidence fewer than 88.2 % would "
        "be."
    )
    said = promise_sentence(
        "step", {}, "damping", promise(1, 10, figure="damping", limit=0.5, at_least=True, bound=0.5), 0.95
    )
    assert said.startswith("Damping: 1 of 10 steps below 0.5 (10 %)")


def test_currents_that_no_hardware_carries_are_told_beside_survived() -> None:
    survival = promise(0, 500, figure="recovery_s", survival=True, limit=2.8)
    beyond = {"above_pu": 2.0, "survived": 12, "largest_pu": 39.2, "cases": list(range(100, 112))}
    said = promise_sentences(
        {"confidence": 0.99, "families": {"sag": {"promises": {"survival": survival}, "beyond_hardware": beyond}}}
    )
    assert said[1:] == [
        "Survived, but above 2 pu, more than hardware carries: 12 sags (up to 39.2 pu: cases 100, 101, 102, 103, 104, "
        "105, 106, 107, …)."
    ]
    none = {"promises": {"survival": survival}, "beyond_hardware": beyond | {"survived": 0, "cases": []}}
    assert len(promise_sentences({"confidence": 0.99, "families": {"sag": none}})) == 1


def test_nothing_is_known_of_what_was_not_judged() -> None:
    said = promise_sentence("own_kind", {}, "overshoot", promise(0, 0), 0.99)
    assert said == "Overshoot: no cases of own kind were judged, so nothing is known."
    assert bound_text(promise(0, 0)) == "–"


def test_a_printed_bound_is_never_less_than_the_bound() -> None:
    for bound in np.exp(np.random.default_rng(4).uniform(math.log(1e-8), 0.0, 300)):
        text = bound_text({"bound": float(bound), "one_in": one_in_of(float(bound))})
        if text.startswith("1 in "):
            printed = 1.0 / int(text.removeprefix("1 in ").replace(",", ""))
        else:
            printed = float(text.removesuffix(" %")) / 100.0
        assert bound * (1.0 - 1e-9) <= printed <= 1.011 * bound


def test_a_worst_value_is_told_apart_from_its_limit() -> None:
    for worst, broken, text in (
        (0.050004, 1, "5.0004 %"),
        (0.05, 0, "5 %"),
        (None, 1, "∞"),
        (None, 0, "–"),
    ):
        assert worst_text("overshoot", {"limit": 0.05, "worst": worst, "broken": broken}) == text


def test_the_headline_counts_promises() -> None:
    whole, broken = document(runs=800, broken=False), document(broken=True)
    assert kept(whole)
    assert not kept(broken)
    assert headline(whole) == f"Every promise was kept in all of {whole['judged']} judged cases, of 800 drawn."
    count = sum(p["broken"] > 0 for family in broken["families"].values() for p in family["promises"].values())
    assert count > 1
    assert headline(broken).startswith(f"{count} of 5 promises were broken at least once in 5,")
    assert len(promise_sentences(broken)) == 5
    empty = document(runs=800) | {"judged": 0}
    assert headline(empty) == "Nothing is known: none of 800 drawn cases could be judged."
    assert not kept(empty)


def test_shares_as_percentages() -> None:
    for share, text in ((0.0, "0 %"), (4.2e-4, "0.042 %"), (0.333, "33.3 %"), (0.9999, "99.99 %"), (1.0, "100 %")):
        assert share_text({"share": share}) == text
    assert share_text({"share": None}) == "–"
