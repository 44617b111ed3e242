"""The guess that never looks: what any method must be better than."""

from __future__ import annotations

from dataclasses import dataclass

from vsgdesign.identification.interface import Estimate, Installation, Needs, NoMemory, Samples


@dataclass(frozen=True)
class ConstantGuess:
    """Always the same grid."""

    at: Installation
    title: str = "Constant guess"
    signals: str = "none"

    @property
    def needs(self) -> Needs:
        """Windows, to answer in the pace of the others."""
        return Needs(self.at.samples, self.at.sample_interval)

    def first(self) -> NoMemory:
        """Nothing."""
        return NoMemory()

    def probe(self, state: NoMemory) -> None:
        """It asks for none."""

    def update(self, state: NoMemory, samples: Samples) -> tuple[NoMemory, Estimate]:  # noqa: ARG002
        """The guess, whatever was measured."""
        return state, Estimate(*self.at.guess, "ok")
