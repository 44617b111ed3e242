"""What a training says of itself in sentences, on a terminal and in Python."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vsgdesign.errors import counted
from vsgdesign.estimator.scenarios import describe_draws

SYNCHRONISED = "synchronised with the grid's phase, as published; no converter in the field can measure it"


def trained_sentences(document: Mapping[str, Any]) -> list[str]:
    """The lines of ``vsgdesign estimator train``, from its JSON; the file of the weights comes first."""
    return _field_sentences(document) if "runs" in document else _window_sentences(document)


def window_sentences(sampling: str, draws: dict[str, Any]) -> list[str]:
    """How windows are sampled, and what was drawn again."""
    again = describe_draws(draws)
    return [f"windows of {sampling}", *([again] if again else [])]


def _window_sentences(document: Mapping[str, Any]) -> list[str]:
    test = document["parts"]["test"]["correlation"]
    return [
        f"{document['file']}: recipe {document['recipe']}, {counted(document['epochs'], 'epoch')}, {document['stop']}; "
        f"on the windows for test R = {test['R_g']:.6f} (R_g), {test['L_g']:.6f} (L_g)",
        f"error of Z on grids that it was not trained on: {_errors(document['parts']['test']['errors'])}",
        *window_sentences(document["window"]["text"], document["draws"]),
        *([SYNCHRONISED] if document["synchronised"] else []),
    ]


def _field_sentences(document: Mapping[str, Any]) -> list[str]:
    runs, seconds = document["runs"], document["timing_s"]
    broken = document["broken_off"]
    return [
        f"{document['file']}: recipe {document['recipe']}, {counted(sum(runs.values()), 'run')} in "
        f"{seconds['runs']:.0f} s, trained in {seconds['training']:.0f} s; on the {counted(runs['test'], 'run')} "
        "for test, with the network behind its gate instead of the recursions alone:",
        *(f"- {sentence}" for sentence in document["verdict"]),
        *([f"{counted(broken, 'run')} diverged and ended early"] if broken else []),
    ]


def _errors(found: Mapping[str, Mapping[str, tuple[float, float]]]) -> str:
    """Median and 95th percentile of the error, at rest and after a change, as far as there are windows."""
    parts = [
        f"{words} {100.0 * found[kind]['Z'][0]:.2g} % (95th percentile {100.0 * found[kind]['Z'][1]:.2g} %)"
        for kind, words in (("rest", "at rest"), ("after_change", "after a change"))
        if found[kind]["Z"][0] >= 0.0
    ]
    return ", ".join(parts)
