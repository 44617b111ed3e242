"""The estimator: an epoch, a training to its goal, certified digits of the solver, one estimate."""

from __future__ import annotations

import importlib.util
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from bench.timing import Figure, Row, figure, repeat, scaled
from vsgdesign.artifacts.network_weights import NetworkWeights, WindowFormat
from vsgdesign.estimator.data_set import DataSet
from vsgdesign.estimator.levenberg_marquardt import (
    Damping,
    NetworkProblem,
    Shape,
    initial_parameters,
    minimise,
    with_ones,
)
from vsgdesign.estimator.recipes import WINDOW_RECIPES
from vsgdesign.estimator.specification import WINDOW_NETWORK, generate
from vsgdesign.estimator.training import train_network
from vsgdesign.identification.neural import neural_estimator
from vsgdesign.study.parameters import load_study

ROOT = Path(__file__).resolve().parents[1]
PUBLISHED = ROOT / "studies" / "published" / "study.toml"
WINDOWS = 3500
SEEDS = 10
LIBRARY = "torch-levenberg-marquardt 1.2.3"
ONE_DAMPING = Damping(goal=0.0, least_gradient=0.0, epochs=5)


def random_problem(inputs: int) -> NetworkProblem:
    """Inputs without structure: an epoch costs the same whatever they are."""
    rng = np.random.default_rng(0)
    x = with_ones(torch.from_numpy(rng.standard_normal((WINDOWS, inputs))))
    return NetworkProblem(Shape(inputs, 8, 2), x, torch.from_numpy(np.tanh(rng.standard_normal((WINDOWS, 2)))))


def one_epoch(problem: NetworkProblem) -> list[float]:
    """Seconds an epoch: a linearisation and as many steps and costs as are needed; the last has none."""
    start = initial_parameters(problem.shape, 0)
    return [seconds / (ONE_DAMPING.epochs + 1) for seconds in repeat(lambda: minimise(problem, start, ONE_DAMPING))]


def library_epoch(problem: NetworkProblem) -> Figure | None:
    """Seconds of a step of the library on the same data in this process; None where it is not installed."""
    if importlib.util.find_spec("torch_levenberg_marquardt") is None:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from torch_levenberg_marquardt.training import LevenbergMarquardtModule  # type: ignore[import-not-found]

    x, y, shape = problem.inputs[:, :-1].contiguous(), problem.targets, problem.shape
    torch.manual_seed(0)
    layers = torch.nn.Linear(shape.inputs, 8), torch.nn.Tanh(), torch.nn.Linear(8, 2)
    module = LevenbergMarquardtModule(torch.nn.Sequential(*layers).double(), solve_method="cholesky")
    return figure(repeat(lambda: module.training_step(x, y), 5))


def epoch() -> list[Row]:
    """Both forms of the published network's epoch."""
    full, components = random_problem(200), random_problem(10)
    library = library_epoch(full)
    anchor, whose = (1.41, f"{LIBRARY}, elsewhere") if library is None else (library.value, f"{LIBRARY} here, Cholesky")
    both = figure(one_epoch(full))
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # as training does with components
    ten, thirty = (scaled(figure(one_epoch(problem)), 1e3) for problem in (components, random_problem(30)))
    torch.set_num_threads(threads)
    what = f"Levenberg–Marquardt epoch, {WINDOWS} windows, 8 tanh units, 2 outputs"
    return [
        Row("epoch", f"{what}, 200 inputs", both, "s", anchor, whose, 0.5, "one product of 1608 × 3500 × 1608"),
        Row("epoch", f"{what}, 10 components", ten, "ms", 1e3 * anchor, whose, 10.0, "tanh and sums over windows"),
        Row("epoch", f"{what}, 30 components", thirty, "ms", 1e3 * anchor, whose, 10.0, "the same product, 248 wide"),
    ]


def training() -> list[Row]:
    """The published network on both recipes, from ten seeds; the slowest seed is ``high``."""
    rows = []
    for recipe in ("published", "continuous"):
        data = _windows(recipe)
        targets, split = np.column_stack([data.R_g, data.L_g]), data.split()
        seconds, reached, worst = [], 0, 1.0
        for seed in range(SEEDS):
            begin = time.perf_counter()
            done = train_network(data.windows, targets, split, seed=seed)
            seconds.append(time.perf_counter() - begin)
            reached += done.stop == "goal"
            worst = min(worst, *(min(part.correlation) for part in done.metrics.values()))
        what = (
            f"{recipe}, 5,000 PWM windows: training to 1e-5, {reached} of {SEEDS} seeds reach it, least R {worst:.5f}"
        )
        rows.append(Row("training", what, figure(seconds), "s", target=5.0, limit="the principal components"))
    return rows


def _windows(recipe: str) -> DataSet:
    return generate(WINDOW_NETWORK, load_study(PUBLISHED), WINDOW_RECIPES.named(recipe), 1)


def estimate() -> list[Row]:
    """One estimate of the runtime, in NumPy."""
    data = _windows("published")
    done = train_network(data.windows, np.column_stack([data.R_g, data.L_g]), data.split())
    box = {name: (float(values.min()), float(values.max())) for name, values in (("R_g", data.R_g), ("L_g", data.L_g))}
    window = WindowFormat(data.samples, data.sample_interval, data.channels, data.synchronised)
    weights = NetworkWeights(network=done.network, window=window, trained_on=box)
    estimator = neural_estimator(
        weights, sample_interval=data.sample_interval, grid_phase=True, v_limit=800.0, i_limit=100.0
    )
    v, i, count = data.windows[0, :100].copy(), data.windows[0, 100:].copy(), 2000

    def several() -> None:
        for _ in range(count):
            estimator.estimate(v, i)

    one = scaled(figure(repeat(several)), 1e6 / count)
    return [
        Row(
            "estimate",
            "one estimate from 200 samples, checks and all",
            one,
            "us",
            13.0,
            "NumPy, network and table without checks",
            20.0,
            "NumPy's calls",
        )
    ]


def certified() -> list[Row]:
    """NIST's certified problems from both starts, with the dense step."""
    sys.path.insert(0, str(ROOT))
    from tests.estimator.nist_problems import load_problems

    problems, to_rounding = load_problems(), Damping(epochs=2000, goal=0.0, least_gradient=0.0, mu=1.0)
    fits = [(p, minimise(p.residuals, start, to_rounding)) for p in problems.values() for start in p.starts]
    solved = [digits for p, fit in fits if (digits := p.digits(fit.x)) >= 6.0]
    what = (
        f"NIST StRD, {len(fits)} starts: {len(solved)} solved to 6 digits and more, median {np.median(solved):.1f}; all"
    )
    begin = time.perf_counter()
    for p in problems.values():
        for start in p.starts:
            minimise(p.residuals, start, to_rounding)
    return [
        Row("certified", what, figure([time.perf_counter() - begin]), "s", limit="small matrices, MGH10's 2000 epochs")
    ]


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {
    "epoch": epoch,
    "training": training,
    "estimate": estimate,
    "certified": certified,
}
