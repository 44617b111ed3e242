"""The interface of every result: it shows itself as text, as figures, as HTML in a notebook, as plain data and as data
frames; and what functions are given in place of a study.

pandas and xarray are optional and imported when they are used.
"""

from __future__ import annotations

import itertools
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from vsgdesign.artifacts.time_series import UNITS
from vsgdesign.errors import ArtifactError, VsgDesignError, did_you_mean
from vsgdesign.study.given_files import RESULT_BYTES, read_given
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.studies import load

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from vsgdesign.report.drawing.figures import NamedFigure


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

    def _figures(self) -> Iterator[NamedFigure]:
        """All figures, if there are any. The most important one comes first."""
        yield from ()

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


def names_of(given: Sequence[str | Path] | str | Path | None) -> tuple[str, ...]:
    """Names as a verb takes them. A single text is one name, and not a sequence of letters."""
    one = isinstance(given, str | Path)
    return (str(given),) if one else tuple(map(str, given or ()))


Bridge = Literal["averaged", "pwm"]
BRIDGES = ("averaged", "pwm")


def known_word(name: str, given: str, known: Sequence[str]) -> None:
    """Raises ValueError for an argument that is none of the words that a function knows."""
    if given not in known:
        raise ValueError(f'{name} = "{given}": must be one of {", ".join(known)}.')


_HEAD = re.compile(r"^(?P<name>.*?)(?: \[(?P<unit>[^\]]*)\])?$")


def frame_of(header: Sequence[str], rows: Iterable[Sequence[object]], **about: Any) -> pd.DataFrame:
    """A data frame of the rows of a CSV file. Its ``attrs`` have ``units``, by column, and ``about`` it."""
    pandas = _library("pandas", "frame()")
    names, units = named_units(header)
    found = pandas.DataFrame([list(row) for row in rows], columns=names)
    found.attrs = {"units": units, **about}
    return found


def dataset_of(frame: pd.DataFrame, axes: Mapping[str, Any]) -> xr.Dataset:
    """The columns of a frame over the axes in which its rows run, the last one fastest. Units are ``attrs`` of each."""
    library = _library("xarray", "dataset()")
    units, shape = frame.attrs["units"], tuple(len(values) for values in axes.values())
    coords = {dimension(name): np.asarray(values) for name, values in axes.items()}
    variables = {
        name: (tuple(coords), frame[name].to_numpy().reshape(shape), {"units": units[name]} if name in units else {})
        for name in frame.columns
        if name not in axes
    }
    about = {name: value for name, value in frame.attrs.items() if name != "units"}
    return library.Dataset(variables, coords, about)


def dimension(name: str) -> str:
    """The name of an axis as that of a dimension: scr, x_over_r, or with "_" for what is no letter."""
    return {"SCR": "scr", "X/R": "x_over_r"}.get(name, re.sub(r"\W+", "_", name))


def named_units(header: Iterable[str]) -> tuple[list[str], dict[str, str]]:
    """The names of the columns of a CSV file, and the units of those that have one."""
    names, units = [], {}
    for head in header:
        found = _HEAD.match(head)
        name, unit = (head, None) if found is None else found.group("name", "unit")
        names.append(name)
        if (unit := unit or UNITS.get(name)) is not None:
            units[name] = unit
    return names, units


def _library(name: str, what: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise VsgDesignError(
            f'{what} needs {name}, which is not installed: pip install "vsgdesign[frames]" brings it.'
        ) from None
