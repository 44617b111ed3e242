"""From a recipe to weights: runs, arrays, training. One way for both networks, each of which is a specification."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar, Unpack

import numpy as np

from vsgdesign.artifacts.field_weights import FIELD_WEIGHTS_FILE
from vsgdesign.artifacts.guarded_file import GuardedFile
from vsgdesign.artifacts.network_weights import WEIGHTS_FILE
from vsgdesign.errors import Fault, StudyError
from vsgdesign.estimator.blocks import ArraysJob, made_arrays
from vsgdesign.estimator.data_set import (
    Arrays,
    DataSet,
    FieldCycles,
    Rows,
    check_data_target,
    check_enough,
    write_data_set,
)
from vsgdesign.estimator.field_runs import cycles_header, draw_field_scenarios, run_cycles
from vsgdesign.estimator.recipe_fields import Library, Recipe, check_recipe
from vsgdesign.estimator.recipes import FIELD_RECIPES, WINDOW_RECIPES, FieldRecipe, WindowRecipe, with_sampling
from vsgdesign.estimator.scenarios import check_draws, draw_scenarios
from vsgdesign.estimator.trained import (
    Trained,
    TrainedEstimator,
    TrainedFieldNetwork,
    require_torch,
    train_on_cycles,
    train_on_windows,
)
from vsgdesign.estimator.windows import run_windows, windows_header
from vsgdesign.execution.executors import How
from vsgdesign.execution.progress import Progress, silent
from vsgdesign.parameters import load_study
from vsgdesign.parameters.loading import study_from_text
from vsgdesign.parameters.study import Study

R = TypeVar("R", bound=Recipe)
D = TypeVar("D", bound=Rows)
T = TypeVar("T", bound=Trained)
Studies = tuple[Study, ...]

_CASE = (
    'base = "case:{0}"\nstudy.name = "{0}"\nsimulation = {{ duration = "1 s", P_ref = 0, Q_ref = 0 }}\n'
    'controllers = [{{ name = "field", kind = "scheduled" }}]\n'
)
"""A packaged case as a study: what a case leaves open is drawn from the recipe anyway."""


@dataclass(frozen=True, kw_only=True)
class Specification(Generic[R, D, T]):
    """What the pipeline has to know of one network. Its functions can be sent to other processes."""

    recipes: Library[R]
    what: str
    """Word for its data, in the progress and in errors."""
    block: int
    """Runs that are made, kept and handed between processes together."""
    size: tuple[str, ...]
    """Fields of a recipe that a call may replace without another data set."""
    complete: Callable[[R, Study], R]
    """The recipe with what follows from the converter filled in."""
    converters: Callable[[R], Sequence[str]]
    """Further converters, "case:NAME" or study files, beside that of the study."""
    header: Callable[[Studies, R, int], dict[str, Any]]
    """The header of the data, of a seed."""
    check: Callable[[Studies, R, int], None]
    """Asked before the first run is made. Raises InfeasibleStudyError if most draws cannot be run."""
    draw: Callable[[Studies, R, int, Sequence[int]], Sequence[Any]]
    """The scenarios of some indices."""
    run: Callable[[Studies, R, Any], Arrays]
    """The arrays of a scenario, which is simulated."""
    data: type[D]
    train: Callable[[D, R, Mapping[str, int], int, Progress], T]
    file: GuardedFile[Any]
    """Of its weights."""


WINDOW_NETWORK: Specification[WindowRecipe, DataSet, TrainedEstimator] = Specification(
    recipes=WINDOW_RECIPES,
    what="windows",
    block=20,
    size=("hidden", "components", "starts"),
    complete=lambda recipe, study: with_sampling(recipe, study.converter),
    converters=lambda _: (),
    header=windows_header,
    check=lambda studies, recipe, seed: check_draws(studies[0], recipe, seed),
    draw=draw_scenarios,
    run=run_windows,
    data=DataSet,
    train=train_on_windows,
    file=WEIGHTS_FILE,
)
"""The network of the paper's windows."""

FIELD_NETWORK: Specification[FieldRecipe, FieldCycles, TrainedFieldNetwork] = Specification(
    recipes=FIELD_RECIPES,
    what="runs",
    block=6,
    size=("hidden",),
    complete=lambda recipe, _: recipe,
    converters=lambda recipe: recipe.converters,
    header=cycles_header,
    check=lambda *_: None,
    draw=draw_field_scenarios,
    run=run_cycles,
    data=FieldCycles,
    train=train_on_cycles,
    file=FIELD_WEIGHTS_FILE,
)
"""The network behind the field estimator."""


def specification_of(recipe: str | Path) -> Specification[Any, Any, Any]:
    """Whose recipe it is, given by name or as a TOML file. Raises StudyError if the file cannot be read."""
    return FIELD_NETWORK if FIELD_RECIPES.has(recipe) else WINDOW_NETWORK


def generate(
    network: Specification[R, D, Any],
    study: Study,
    recipe: R,
    seed: int,
    *,
    out: str | Path | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    **how: Unpack[How],
) -> D:
    """The data of a recipe on a study's converter, and their file if ``out`` is given.

    The study, and those of the recipe's further converters, give converter, filter, inner loops, limiter and the target
    of the gains; grid, source, disturbances, set points and bridge come from the recipe. The result depends on study,
    recipe and seed alone, not on the workers that ``how`` asks for (an ``executor`` replaces them). What the recipe
    leaves open follows from the converter; the header has it filled in. With ``out``, finished blocks are kept beside
    it until the file is whole, so that the same call takes up an interrupted one. Raises StudyError for a faulty recipe
    or seed, InfeasibleStudyError where a converter cannot run what is drawn, ArtifactError where the file cannot be
    written.
    """
    check_recipe(recipe)
    workers = how.get("workers", 1)
    for name, value, least in (("seed", seed, "zero"), ("workers", 1 if workers is None else workers, "one")):
        if isinstance(value, bool) or not isinstance(value, int) or value < int(least == "one"):
            fault = Fault(name, str(value), f"must be a whole number, {least} or more")
            raise StudyError(network.what, [fault])
    if out is not None:
        check_data_target(out)
    studies = studies_of(study, network.converters(recipe))
    recipe = network.complete(recipe, study)
    header = network.header(studies, recipe, seed)
    starts = range(0, recipe.count, network.block)
    blocks = [range(first, min(first + network.block, recipe.count)) for first in starts]
    job = ArraysJob(
        what=network.what,
        header=header | {"block": network.block},
        make=make_block,
        arguments=[(network.draw, network.run, studies, recipe, seed, block) for block in blocks],
    )
    with made_arrays(
        job,
        out,
        executor=executor,
        progress=progress or silent,
        before=lambda: network.check(studies, recipe, seed),
        **how,
    ) as arrays:
        data = network.data(**arrays, header=header)
        if out is not None:
            write_data_set(out, data)
    return data


def make_block(
    draw: Callable[..., Sequence[Any]],
    run: Callable[..., Arrays],
    studies: Studies,
    recipe: Recipe,
    seed: int,
    indices: range,
) -> Arrays:
    """The arrays of some runs, one after another."""
    rows = [run(studies, recipe, scenario) for scenario in draw(studies, recipe, seed, indices)]
    return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}


def train(
    network: Specification[R, D, T],
    study: Study,
    recipe: R,
    *,
    seed: int = 0,
    size: Mapping[str, int | None] | None = None,
    out: str | Path | None = None,
    progress: Progress = silent,
    **how: Unpack[How],
) -> T:
    """Makes the data of a recipe, trains the network on them and judges it.

    ``size`` replaces values of the recipe by name, except those that are None. ``out`` keeps the data, and the finished
    blocks of an interrupted call. The same arguments give the same weights, however the data are made (``how``). An
    interrupted training, which takes seconds, raises KeyboardInterrupt. Raises InfeasibleStudyError without PyTorch,
    and the errors of :func:`generate`.
    """
    require_torch()
    check_recipe(recipe)
    check_enough(recipe.count, recipe.counted)
    begin = time.perf_counter()
    data = generate(network, study, recipe, seed, out=out, progress=progress, **how)
    made = time.perf_counter() - begin
    given = {name: value for name, value in (size or {}).items() if value is not None}
    whole: dict[str, int] = {name: getattr(recipe, name) for name in network.size} | given
    trained = network.train(data, recipe, whole, seed, progress)
    return replace(trained, timing_s={network.what: made, "training": time.perf_counter() - begin - made})


def studies_of(study: Study, converters: Sequence[str]) -> Studies:
    """The study and further converters. Raises StudyError naming the one that cannot be read."""
    found = [study]
    for one in converters:
        try:
            case = one.removeprefix("case:")
            found.append(load_study(one) if case == one else study_from_text(_CASE.format(case), one))
        except StudyError as error:
            raise StudyError(
                "recipe", [Fault("converters", f'"{one}"', str(error), "Give case:NAME or the file of a study.")]
            ) from error
    return tuple(found)
