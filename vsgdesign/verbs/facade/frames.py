"""Results as pandas data frames and xarray data sets. Both libraries are optional and imported when they are used."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.artifacts.time_series import UNITS
from vsgdesign.errors import VsgDesignError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

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
