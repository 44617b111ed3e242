"""What the facade's functions are given in place of a study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.studies import load


def given_study(study: Study | str | Path, what: str) -> Study:
    """A study, or that of a file. Raises TypeError for anything else, and the errors of
    :func:`vsgdesign.verbs.facade.studies.load`."""
    if isinstance(study, str | Path):
        return load(study)
    if not isinstance(study, Study):
        raise TypeError(
            f'{what} takes a study, such as vd.load("study.toml"), or the name of its file, and not '
            f"{type(study).__name__}."
        )
    return study


def known_word(name: str, given: str, known: Sequence[str]) -> None:
    """Raises ValueError for an argument that is none of the words that a function knows."""
    if given not in known:
        raise ValueError(f'{name} = "{given}": must be one of {", ".join(known)}.')
