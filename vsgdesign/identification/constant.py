"""The constant guess. It ignores all measurements, so every useful method must be better than it."""

from __future__ import annotations

from dataclasses import dataclass

from vsgdesign.identification.interface import Estimate, Installation, Needs, NoMemory, Samples


@dataclass(frozen=True)
class ConstantGuess:
    """An estimator that always answers with the same grid."""

    at: Installation
    title: str = "Constant guess"
    signals: str = "none"

    @property
    def needs(self) -> Needs:
        """It takes windows, so that it answers as often as the other methods."""
        return Needs(self.at.samples, self.at.sample_interval)

    def first(self) -> NoMemory:
        """Nothing."""
        return NoMemory()

    def probe(self, state: NoMemory) -> None:
        """This method needs no probe."""

    def update(self, state: NoMemory, samples: Samples) -> tuple[NoMemory, Estimate]:  # noqa: ARG002
        """Returns the guess, whatever was measured."""
        return state, Estimate(*self.at.guess, "ok")
