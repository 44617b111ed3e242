"""Which grids of a comparison a converter can be run on: asked before anything is trained or simulated."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.estimator.recipes import WindowRecipe
from vsgdesign.estimator.scenarios import why_not
from vsgdesign.parameters.study import Study

if TYPE_CHECKING:
    from vsgdesign.estimator.comparison import ComparisonSettings


def runnable_settings(study: Study, settings: ComparisonSettings) -> tuple[ComparisonSettings, tuple[str, ...]]:
    """The settings with the grids alone that the converter can be run on, and a sentence on each that is left out.

    A step from or to a grid that is left out begins or ends at the nearest SCR that is not. Raises
    InfeasibleStudyError where no grid is left.
    """
    reasons = {
        scr: why_not(study, replace(settings, scr=(scr,)).recipe(), settings.seed)
        for scr in sorted({*settings.scr, *(scr for pair in settings.grid_steps for scr in pair)})
    }
    kept = [scr for scr, reason in reasons.items() if not reason]
    left_out = tuple(_sentence(f"SCR {scr:g}", reason) for scr, reason in reasons.items() if reason)
    if not any(scr in kept for scr in settings.scr):
        raise InfeasibleStudyError(
            f"none of the comparison's grids can be run with P = {settings.P_pu:g} pu, Q = {settings.Q_pu:g} pu and "
            f"X/R {settings.x_over_r:g}: {' '.join(left_out)}"
        )
    pairs = (tuple(min(kept, key=lambda one: abs(one - scr)) for scr in pair) for pair in settings.grid_steps)
    steps = tuple(dict.fromkeys((first, then) for first, then in pairs if first != then))
    return replace(settings, scr=tuple(scr for scr in settings.scr if scr in kept), grid_steps=steps), left_out


def runnable_values(
    study: Study, recipes: dict[float, WindowRecipe], what: str, seed: int
) -> tuple[tuple[float, ...], tuple[str, ...]]:
    """Of recipes by the value that each stands for, the values that can be run, and a sentence on each other."""
    reasons = {value: why_not(study, recipe, seed) for value, recipe in recipes.items()}
    left_out = (_sentence(f"{what} {value:g}", reason) for value, reason in reasons.items() if reason)
    return tuple(value for value, reason in reasons.items() if not reason), tuple(left_out)


def _sentence(what: str, reason: str) -> str:
    return f"{what} is left out: {reason}."


def nominal_settings(settings: ComparisonSettings) -> ComparisonSettings:
    """Those of the one grid that a stress is about."""
    return replace(settings, scr=(8.0,), grid_steps=())
