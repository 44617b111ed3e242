"""NIST's certified nonlinear regression problems, with Jacobians by the complex step."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, cos, exp, sin

from vsgdesign.estimator.levenberg_marquardt import Linearised

MODELS: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "Bennett5": lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
    "BoxBOD": lambda b, x: b[0] * (1 - exp(-b[1] * x)),
    "Chwirut": lambda b, x: exp(-b[0] * x) / (b[1] + b[2] * x),
    "DanWood": lambda b, x: b[0] * x ** b[1],
    "ENSO": lambda b, x: (
        b[0]
        + b[1] * cos(math.pi * x / 6)
        + b[2] * sin(math.pi * x / 6)
        + b[4] * cos(2 * math.pi * x / b[3])
        + b[5] * sin(2 * math.pi * x / b[3])
        + b[7] * cos(2 * math.pi * x / b[6])
        + b[8] * sin(2 * math.pi * x / b[6])
    ),
    "Eckerle4": lambda b, x: b[0] / b[1] * exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Gauss": lambda b, x: (
        b[0] * exp(-b[1] * x) + b[2] * exp(-((x - b[3]) ** 2) / b[4] ** 2) + b[5] * exp(-((x - b[6]) ** 2) / b[7] ** 2)
    ),
    "Hahn1": lambda b, x: (b[0] + b[1] * x + b[2] * x**2 + b[3] * x**3) / (1 + b[4] * x + b[5] * x**2 + b[6] * x**3),
    "Kirby2": lambda b, x: (b[0] + b[1] * x + b[2] * x**2) / (1 + b[3] * x + b[4] * x**2),
    "Lanczos": lambda b, x: b[0] * exp(-b[1] * x) + b[2] * exp(-b[3] * x) + b[4] * exp(-b[5] * x),
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "MGH10": lambda b, x: b[0] * exp(b[1] / (x + b[2])),
    "MGH17": lambda b, x: b[0] + b[1] * exp(-x * b[3]) + b[2] * exp(-x * b[4]),
    "Misra1a": lambda b, x: b[0] * (1 - exp(-b[1] * x)),
    "Misra1b": lambda b, x: b[0] * (1 - (1 + b[1] * x / 2) ** -2),
    "Misra1c": lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5),
    "Misra1d": lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    "Rat42": lambda b, x: b[0] / (1 + exp(b[1] - b[2] * x)),
    "Rat43": lambda b, x: b[0] / (1 + exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Roszman1": lambda b, x: b[0] - b[1] * x - torch.arctan(b[2] / (x - b[3])) / math.pi,
}
MODELS["Thurber"] = MODELS["Hahn1"]
"""By problem, or by family: Gauss for Gauss1 to Gauss3."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """A small dense problem: residuals r(x) with their Jacobian. The cost is the sum of squares ‖r‖².

    ``residual`` returns (N,) and ``jacobian`` (N, n) for x (n,). The damping uses the norms of the Jacobian's columns
    as units, so that the parameters may have any size. The step is solved by QR as an augmented least-squares problem,
    which does not square the condition number (docs/theory/levenberg-marquardt.md).
    """

    residual: Callable[[Tensor], Tensor]
    jacobian: Callable[[Tensor], Tensor]

    def cost(self, x: Tensor) -> float:
        """Sum of squares."""
        r = self.residual(x)
        return float(r @ r)

    def linearise(self, x: Tensor) -> Linearised:
        """The problem at x, with one QR factorisation of the scaled Jacobian for all dampings."""
        r, J = self.residual(x), self.jacobian(x)
        scale = torch.linalg.vector_norm(J, dim=0)
        scale = torch.where(scale > 0.0, scale, torch.ones_like(scale))
        Q, R = torch.linalg.qr(J / scale)
        gradient = float(torch.linalg.vector_norm(2.0 * (J.T @ r)))
        return _Triangular(float(r @ r), gradient, R, Q.T @ r, scale)


@dataclass(frozen=True, eq=False)
class _Triangular:
    cost: float
    gradient_norm: float
    R: Tensor
    Q_r: Tensor
    scale: Tensor

    def step(self, mu: float) -> Tensor | None:
        n = len(self.scale)
        rows = torch.cat([self.R, math.sqrt(mu) * torch.eye(n, dtype=self.R.dtype)])
        right = torch.cat([-self.Q_r, torch.zeros(n, dtype=self.R.dtype)])
        Q, R = torch.linalg.qr(rows)
        if bool((R.diagonal() == 0.0).any()):
            return None
        return torch.linalg.solve_triangular(R, (Q.T @ right)[:, None], upper=True)[:, 0] / self.scale


@dataclass(frozen=True, eq=False)
class CertifiedProblem:
    """One problem: its residuals, both starts, the certified parameters and sum of squares."""

    name: str
    level: str
    residuals: Residuals
    starts: tuple[Tensor, Tensor]
    certified: Tensor
    sum_of_squares: float

    def digits(self, x: Tensor) -> float:
        """Correct digits of the worst parameter."""
        return -math.log10(float(((x - self.certified) / self.certified).abs().max()) + 1e-16)


def load_problems() -> dict[str, CertifiedProblem]:
    """All problems by name."""
    text = (Path(__file__).parent / "nist" / "nonlinear.json").read_text(encoding="utf-8")
    return {name: _problem(name, document) for name, document in json.loads(text).items()}


def _problem(name: str, document: dict) -> CertifiedProblem:
    model = MODELS.get(name) or MODELS[name.rstrip("123")]
    x, y, first, second, certified = (
        torch.tensor(document[key], dtype=torch.float64) for key in ("x", "y", "start_1", "start_2", "certified")
    )

    def jacobian(b: Tensor) -> Tensor:
        step = 1e-30 * b.abs()
        columns = torch.diag(torch.complex(torch.zeros_like(b), step)) + b
        return torch.stack([model(column, x).imag / h for column, h in zip(columns, step, strict=True)], dim=1)

    residuals = Residuals(lambda b: model(b, x) - y, jacobian)
    total = document["residual_sum_of_squares"]
    return CertifiedProblem(name, document["level"], residuals, (first, second), certified, total)
