"""The interface of every result: it shows itself as text, as figures, as HTML in a notebook, and as plain data."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.errors import ArtifactError, did_you_mean
from vsgdesign.study.given_files import RESULT_BYTES, read_given

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from vsgdesign.report.drawing.figure_types import NamedFigure

_MARK = "vsgdesign"

_MARKED_FIELDS = {".png": "Software", ".svg": "Creator", ".pdf": "Creator"}
"""The field of each image format that says what drew it. A picture of the user's own is never replaced."""


class Shown(ABC):
    """A result with its sentences, its figures and its data."""

    @property
    @abstractmethod
    def title(self) -> str:
        """A short title, which says of what this is the result."""

    @abstractmethod
    def sentences(self) -> Sequence[str]:
        """The answer, in whole sentences."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """The result in JSON's types, as in its results.json."""

    @abstractmethod
    def _figures(self) -> Iterator[NamedFigure]:
        """All figures. The most important one comes first."""

    @property
    def pictures(self) -> tuple[str, ...]:
        """The names that :meth:`plot` accepts. Without a name it draws the first of them."""
        return tuple(figure.name for figure in self._figures())

    def plot(self, picture: str | None = None, *, file: str | Path | None = None) -> Figure:
        """Draws one figure by its name and, if ``file`` is given, writes it to this file.

        Without a name it draws the first of :attr:`pictures`. ``file`` ends in .png, .svg or .pdf. An existing file is
        replaced if vsgdesign drew it, and left unchanged otherwise. Returns the matplotlib figure. Raises
        KeyError for an unknown name and ArtifactError for a file that cannot be written.
        """
        found = self._named(picture)
        if file is not None:
            _save(found.figure, Path(file))
        return found.figure

    def _named(self, picture: str | None) -> NamedFigure:
        names = []
        for figure in self._figures():
            if picture in (None, figure.name):
                return figure
            names.append(figure.name)
        if picture is None:
            raise KeyError("this result has no picture")
        advice = did_you_mean(picture, names, f"There are: {', '.join(names)}.")
        raise KeyError(f"no picture is called {picture!r}. {advice}")

    def _repr_html_(self) -> str:
        """The sentences and then the first figure, for notebooks."""
        from vsgdesign.report.page.blocks import Figure, Heading, words
        from vsgdesign.report.page.html import print_fragment

        first = [Figure(figure) for figure in itertools.islice(self._figures(), 1)]
        return print_fragment([Heading(self.title, 4), words(*self.sentences()), *first])

    def __str__(self) -> str:
        return "\n".join([self.title, *self.sentences()])


def _save(figure: Figure, path: Path) -> None:
    from vsgdesign.report.drawing.style import look
    from vsgdesign.report.drawing.ticks import plain_ticks

    field = _MARKED_FIELDS.get(path.suffix.lower())
    if field is None:
        raise ArtifactError(
            f"{path}: the name of a picture must end in {', '.join(_MARKED_FIELDS)}. Choose one of them."
        )
    if path.is_dir():
        raise ArtifactError(f"{path}: this is a folder. Give the name of a file.")
    try:
        there = read_given(path, RESULT_BYTES) if path.exists() else b""
        if there and _MARK.encode() not in there:
            raise ArtifactError(f"{path}: this file exists and was not drawn by vsgdesign. It was left unchanged.")
        plain_ticks(figure)
        with look():
            figure.savefig(path, metadata={field: _MARK})
    except OSError as error:
        raise ArtifactError(f"{path}: the picture cannot be written ({error.strerror}).") from None
