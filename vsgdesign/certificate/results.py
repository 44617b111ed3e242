"""The statements of a certificate, as data and as a document."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.certificate_record import (
    CertificateCell,
    CertificateRecord,
    StaticLimits,
    StepStatement,
    certificate_record,
)
from vsgdesign.artifacts.files import plain
from vsgdesign.certificate.region import STATES, YIELDING, Region
from vsgdesign.errors import InfeasibleStudyError

Array = NDArray[np.float64]

GAP_FREE = "gap-free"
GRIDDED = "gridded"


@dataclass(frozen=True)
class Gap:
    """The gaps of a gridded proof. All values are zero in a proof without gaps.

    ``share``: of the region's volume, where the inequality is not proved between the points. ``box``: the largest
    box left, as a share of the region along SCR⁻¹, atan X/R, P, Q and both errors. ``decay``: 1/s by which the
    slowest fresh point is better than what is claimed.
    """

    share: float = 0.0
    box: tuple[float, ...] = (0.0,) * 6
    decay: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """V = xᵀP(ρ)x decays at least as e^{−2·decay·t} along every change of grid and estimate within the region.

    x are the ``states`` as deviations over ``scale``. ``P`` (K, n, n): P_0 alone for a common function; else
    P(ρ) = P_0 + ρ_1 P_1 + ρ_2 P_2 with the ρ of :eq:`certificate-coordinates`, and the grid changes no faster than
    ``region.rate``. ``proof``: ``gap-free`` (all points of the region) or ``gridded`` (cells and random points,
    with what the boxes leave open as ``gap``). ``checked`` and ``fresh`` count the cells and the random points at
    which eigenvalues verified the inequality, ``boxes`` the boxes on which it was proved, ``largest`` is the
    largest eigenvalue relative to P(ρ) found, in 1/s (negative: it holds).
    """

    controller: str
    region: Region
    limits: StaticLimits
    decay: float
    sampled: float
    """Decay in 1/s that holds at every cell and random point. It exceeds ``decay`` if the proof on boxes needed
    room."""
    P: Array
    scale: Array
    states: tuple[str, ...]
    proof: str
    gap: Gap
    checked: int
    fresh: int
    boxes: int
    vertices: int
    largest: float
    steps: StepStatement | None = None
    """Where no limit acts (:func:`vsgdesign.certificate.certified_steps`); None where that was not asked."""
    differential: CertificateRecord | None = None
    """What is proved of equal units against each other; None where that was not asked."""

    def as_record(self) -> CertificateRecord:
        """What a gain table keeps."""
        return certificate_record(self.as_document())

    def as_document(self) -> dict[str, Any]:
        """JSON's types, the same for the same inputs. An infinite rate is null."""
        return plain(
            {
                "certified": True,
                "controller": self.controller,
                "region": self.region.as_document(),
                "static_limits": asdict(self.limits),
                "decay": self.decay,
                "sampled": self.sampled,
                "proof": self.proof,
                "gap": asdict(self.gap),
                "P": self.P,
                "scale": self.scale,
                "states": self.states,
                "checked": self.checked,
                "fresh": self.fresh,
                "boxes": self.boxes,
                "vertices": self.vertices,
                "largest": self.largest,
            }
            | _beside(self)
        )


@dataclass(frozen=True, kw_only=True)
class Places:
    """V_k = xᵀP_k x of place k decays at least as e^{−2·decay·t} while the grid is in that place
    (:eq:`place-certificate`).

    ``parts``: the certificate of each place, a part of ``region`` each; they cover it. A move of the grid from any
    place to any other leaves V at no more than ``factor`` times its value.
    """

    region: Region
    parts: tuple[Certificate, ...]
    factor: float
    steps: StepStatement | None = None
    """As of a :class:`Certificate`."""
    differential: CertificateRecord | None = None
    """As of a :class:`Certificate`."""

    @property
    def controller(self) -> str:
        """Its name."""
        return self.parts[0].controller

    @property
    def decay(self) -> float:
        """The slowest of all places, 1/s."""
        return min(part.decay for part in self.parts)

    @property
    def proof(self) -> str:
        """``gap-free`` where that of every place is."""
        return GAP_FREE if all(part.proof == GAP_FREE for part in self.parts) else GRIDDED

    @property
    def dwell_s(self) -> float:
        """Time between two moves from which on, on average, V falls."""
        return float(np.log(self.factor)) / (2.0 * self.decay)

    def as_record(self) -> CertificateRecord:
        """What a gain table keeps."""
        return certificate_record(self.as_document())

    def as_document(self) -> dict[str, Any]:
        """JSON's types, the same for the same inputs."""
        documents = [part.as_document() for part in self.parts]
        first = documents[0]
        slowest = max(documents, key=lambda one: one["gap"]["share"])
        return plain(
            {name: first[name] for name in ("certified", "controller", "static_limits", "scale", "states")}
            | {name: sum(one[name] for one in documents) for name in ("checked", "fresh", "boxes", "vertices")}
            | {
                "region": self.region.as_document(),
                "decay": self.decay,
                "sampled": min(part.sampled for part in self.parts),
                "largest": max(part.largest for part in self.parts),
                "proof": self.proof,
                "gap": slowest["gap"],
                "places": [
                    {name: one["region"][name] for name in ("scr", "x_over_r")} | _own(one) for one in documents
                ],
                "move": {"factor": self.factor, "dwell_s": self.dwell_s},
            }
            | _beside(self)
        )


def _own(document: dict[str, Any]) -> dict[str, Any]:
    return {name: document[name] for name in ("decay", "sampled", "proof", "boxes", "P")}


def _beside(found: Certificate | Places) -> dict[str, Any]:
    """What a proof may have beside it."""
    steps = {} if found.steps is None else {"steps": found.steps.as_document()}
    return steps | ({} if found.differential is None else {"differential": found.differential.document})


def refusal_record(
    reason: str, region: Region, slowest: CertificateCell | None = None, limits: StaticLimits | None = None
) -> CertificateRecord:
    """The reason why there is neither a certificate nor a counterexample over a region, with its slowest cell if
    known."""
    refused: dict[str, Any] = {"certified": False, "reason": reason, "region": region.as_document()}
    if limits is not None:
        refused["static_limits"] = asdict(limits)
    if slowest is not None:
        refused["slowest"] = {name: value for name, value in asdict(slowest).items() if value is not None}
    return certificate_record(refused)


class NoFunctionError(InfeasibleStudyError):
    """Every checked cell is stable, but no function of this kind exists. ``slowest`` is the slowest cell."""

    def __init__(self, text: str, slowest: CertificateCell) -> None:
        super().__init__(text)
        self.slowest = slowest


@dataclass(frozen=True)
class Trajectory:
    """The response of the growing mode: times (s) and the deviations x = (δ in rad, ω_r in rad/s, V in V, and i_f in A
    with a transient impedance), (M, n)."""

    t_s: Array
    x: Array


@dataclass(frozen=True, kw_only=True)
class Counterexample:
    """A cell of the region that no certificate can cover, its least stable eigenvalue (1/s) and how it grows."""

    controller: str
    region: Region
    limits: StaticLimits
    scr: float
    x_over_r: float
    P: float
    Q: float
    error_R: float
    error_L: float
    eigenvalue: complex
    trajectory: Trajectory

    def as_record(self) -> CertificateRecord:
        """What a gain table keeps."""
        return certificate_record(self.as_document())

    def as_document(self) -> dict[str, Any]:
        """JSON's types."""
        names = ("scr", "x_over_r", "P", "Q", "error_R", "error_L")
        return plain(
            {
                "certified": False,
                "controller": self.controller,
                "region": self.region.as_document(),
                "static_limits": asdict(self.limits),
                **{name: getattr(self, name) for name in names},
                "eigenvalue": {"real": self.eigenvalue.real, "imag": self.eigenvalue.imag},
                "trajectory": {
                    "t_s": self.trajectory.t_s,
                    **dict(zip((*STATES, *YIELDING), self.trajectory.x.T, strict=False)),
                },
            }
        )


def growing_mode(A: Array, scale: Array) -> tuple[complex, Trajectory]:
    """The least stable eigenvalue of a scaled A (n, n), and its mode from 1 % of the scale on: four periods, or four
    time constants where it does not swing."""
    values, vectors = np.linalg.eig(A.astype(complex))
    k = int(np.argmax(np.real(values)))
    value, vector = complex(values[k]), vectors[:, k]
    vector = 0.01 * vector / vector[np.argmax(np.abs(vector))]
    swing = abs(value.imag) > 1e-9 * abs(value)
    length = 4.0 * (2.0 * np.pi / abs(value.imag) if swing else 1.0 / max(abs(value.real), 1e-9))
    t_s = np.linspace(0.0, length, 201)
    growth: Any = np.exp(value * t_s)[:, None] * vector
    return value, Trajectory(t_s, growth.real * scale)
