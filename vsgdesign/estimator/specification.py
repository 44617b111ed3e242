"""From a recipe to weights: runs, arrays, training. One way for both networks, each of which is a specification.

Arrays are made in blocks, by one or several processes, and kept so that an interrupted call continues.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import json
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar, Unpack

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.field_weights import FIELD_WEIGHTS_FILE
from vsgdesign.artifacts.guarded_file import GuardedFile
from vsgdesign.artifacts.network_weights import WEIGHTS_FILE
from vsgdesign.errors import Fault, StudyError
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
from vsgdesign.execution.executors import How, Progress, executor_of, silent, worker_count
from vsgdesign.execution.jobs import Job
from vsgdesign.execution.journal import Journal, journal_of, kept_count, run_job
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.loading import study_from_text
from vsgdesign.study.parameters.study import Study

WORK = "blocks"
"""Names the folder beside a file that keeps finished blocks."""


@dataclass(frozen=True, kw_only=True)
class ArraysJob(Job[int, dict[str, Arrays]]):
    """Arrays of many blocks: ``make(*arguments[k])`` gives those of block k."""

    what: str  # type: ignore[misc]
    """The word of the progress."""
    header: dict[str, Any]
    """Recipe, seed and converter in JSON's types: all that the arrays depend on besides the package's source."""
    make: Callable[..., Arrays]
    """A function of a module, because it goes to other processes."""
    arguments: Sequence[tuple[Any, ...]]

    @property
    def key(self) -> str:
        """Hash of the header and of the sources that make the arrays."""
        text = json.dumps(self.header | {"source_stamp": source_stamp()}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def blocks(self) -> range:
        """Numbers of all blocks."""
        return range(len(self.arguments))

    def run(self, block: int) -> dict[str, Arrays]:
        """The arrays of a block, by its number."""
        return self.call(block)()

    def call(self, block: int) -> Callable[[], dict[str, Arrays]]:
        """A block as it goes to another process: with its own arguments alone."""
        return partial(_made, str(block), self.make, self.arguments[block])

    def document(self, part: dict[str, Arrays]) -> dict[str, Any]:
        """Arrays as type, shape and bytes."""
        return {k: {name: _written(values) for name, values in arrays.items()} for k, arrays in part.items()}

    def part_of(self, document: Any) -> dict[str, Arrays]:
        """The arrays of a document. Raises ValueError, KeyError or TypeError where it has none."""
        return {k: {name: _read(values) for name, values in arrays.items()} for k, arrays in document.items()}

    def joined(self, whole: dict[str, Arrays]) -> Arrays:
        """The blocks one after another in one array each."""
        return {name: np.concatenate([whole[str(k)][name] for k in self.blocks]) for name in whole["0"]}


def _made(name: str, make: Callable[..., Arrays], arguments: tuple[Any, ...]) -> dict[str, Arrays]:
    return {name: make(*arguments)}


def _written(values: NDArray[Any]) -> list[Any]:
    return [values.dtype.str, list(values.shape), base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()]


def _read(written: Any) -> NDArray[Any]:
    kind, shape, text = written
    return np.frombuffer(base64.b64decode(text), dtype=kind).reshape(shape)


@contextmanager
def made_arrays(
    job: ArraysJob,
    out: str | Path | None,
    *,
    executor: Executor | None = None,
    progress: Progress,
    before: Callable[[], None] = lambda: None,
    **how: Unpack[How],
) -> Iterator[Arrays]:
    """The arrays of a job. Finished blocks are kept beside ``out``, and removed where the block of ``with`` ends well.

    ``executor`` replaces the workers that ``how`` asks for: one process where it does not say. ``before`` is called if
    any block is missing. Raises ArtifactError and WorkerError.
    """
    with ExitStack() as held:
        journal: Journal[dict[str, Arrays]] = Journal(job, None)
        if out is not None:
            _forget_versions_before(Path(out))
            journal = held.enter_context(journal_of(job, out, WORK, fresh=how.get("fresh", False), say=how.get("say")))
        left = len(job.left(journal.whole))
        if left:
            before()
        with ExitStack() as working:
            if executor is None and left:
                count = min(worker_count(how.get("workers", 1)), left)
                executor = working.enter_context(executor_of(count, how.get("cluster")))
            whole = run_job(job, journal, executor=executor, progress=progress)
        yield job.joined(whole)


def kept_blocks(out: str | Path) -> bool:
    """Whether finished blocks wait beside the file that is to be made of them."""
    return kept_count(out, WORK) > 0


def _forget_versions_before(out: Path) -> None:
    """Remove the folders in which versions before this one kept finished blocks."""
    for folder in out.parent.iterdir() if out.parent.is_dir() else ():
        if folder.name.startswith(f".{out.name}.") and folder.suffix == ".parts":
            shutil.rmtree(folder, ignore_errors=True)


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


_PACKAGE = Path(__file__).resolve().parent.parent
_ROOMS = ("equations", "simulation")


@functools.cache
def source_stamp() -> int:
    """The hash of every source file of the equations and the simulation: data that was simulated with others is
    stale."""
    digest = hashlib.sha256()
    for room in _ROOMS:
        for path in sorted((_PACKAGE / room).rglob("*.py")):
            digest.update(path.read_bytes())
    return int.from_bytes(digest.digest()[:7], "big")
