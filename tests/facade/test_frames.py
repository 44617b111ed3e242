"""Results as pandas data frames and xarray data sets: the figures of the files that the verbs write, with units."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import vsgdesign as vd
from tests import verification_documents
from tests.gain_tables import table as gain_table
from vsgdesign.artifacts.time_series import write_csv, write_table
from vsgdesign.linear.stability.gain_table import nominal_margins
from vsgdesign.runtime.table import with_node_gains
from vsgdesign.simulation.stability_result import map_file
from vsgdesign.verbs.pipeline.margins import write_stability_tables
from vsgdesign.verbs.pipeline.table import CSV_FILE, table_header, table_rows


@pytest.fixture(scope="module")
def study() -> vd.Study:
    axes = {"scr": [2, 4, 8], "x_over_r": [1, 3], "P": ["2 kW", "4.5 kW"], "Q": ["1 kvar"]}
    return vd.load("case:hoang2025_5kva", P_ref="2 kW", duration="0.1 s", stability=axes)


def same_as_file(frame: pd.DataFrame, file: Path, digits: float) -> None:
    """Numbers to the digits of the file, where infinity is empty; everything else as it is, with units."""
    read = pd.read_csv(file)
    units = frame.attrs["units"]
    assert {head.partition(" [")[0] for head in read.columns} == set(frame.columns)
    for head, name in zip(read.columns, frame.columns, strict=True):
        assert head in (name, f"{name} [{units.get(name)}]")
        if frame[name].dtype.kind in "fi":
            ours = frame[name].where(np.isfinite(frame[name]), np.nan)
            np.testing.assert_allclose(ours, read[head].astype(float), rtol=digits)
        else:
            assert [one or "" for one in frame[name]] == list(read[head].fillna("").astype(str))


def test_a_table_is_its_csv_and_its_arrays(tmp_path: Path) -> None:
    table = with_node_gains(gain_table(scr=(2.0, 4.0, 8.0), x_over_r=(1.0, 3.0)))
    table = replace(table, margins=nominal_margins(table))
    shown = vd.DesignedTable(table, {})
    write_table(tmp_path / CSV_FILE, table_header(table), table_rows(table))  # as report_table does
    same_as_file(shown.frame(), tmp_path / CSV_FILE, 1e-8)
    data = shown.dataset()
    assert data["K_ip"].dims == ("scr", "x_over_r")
    assert data["K_ip"].attrs["units"] == "rad/(s2*W)"
    np.testing.assert_array_equal(data["K_ip"], table.gains.K_ip)
    assert float(data["disk_margin_output"].sel(scr=4.0, x_over_r=3.0)) == table.figures["disk_margin_output"][1, 1]
    assert data.attrs == {"table": "closed form", "scr_basis": "impedance"}


def test_margins_are_their_maps(study: vd.Study, tmp_path: Path) -> None:
    margins = vd.margins(study)
    write_stability_tables(margins.result, tmp_path)
    (name,) = margins.to_dict()["controllers"]
    for kind in ("reduced", "full_order", "stale"):
        same_as_file(margins.frame(kind=kind), tmp_path / map_file(name, kind), 1e-8)
    data = margins.dataset(name, "full_order")
    assert dict(data.sizes) == {"scr": 3, "x_over_r": 2, "P_Q": 2}
    cell = data.sel(scr=4.0, x_over_r=3.0).isel(P_Q=1)
    frame = margins.frame(name, "full_order").query("SCR == 4 and `X/R` == 3 and P == 4500")
    assert float(cell["P"]) == 4500.0
    assert float(cell["disk_margin_output"]) == frame["disk_margin_output"].item()
    assert data["spectral_abscissa"].attrs["units"] == "1/s"
    with pytest.raises(KeyError, match="reduced, full_order"):
        margins.frame(kind="worst")  # type: ignore[arg-type]
    with pytest.raises(KeyError, match=name):
        margins.dataset("nobody")


def test_a_run_is_its_series(study: vd.Study, tmp_path: Path) -> None:
    run = vd.simulate(study)
    frame = run.frame()
    write_csv(tmp_path / "run.csv", run.series(), 0.0)
    same_as_file(frame, tmp_path / "run.csv", 1e-6)
    np.testing.assert_array_equal(frame["P_pcc"], run.series()["P_pcc"])
    assert frame.attrs["units"]["P_pcc"] == "W"


def test_a_verification_has_its_promises_and_its_map(tmp_path: Path) -> None:
    document = verification_documents.document()
    found = vd.Verification(document, tmp_path)
    frame = found.frame().set_index(["family", "promise"])
    for family, it in document["families"].items():
        for name, promise in it["promises"].items():
            row = frame.loc[(family, name)]
            assert (row["broken"], row["bound"], row["unit"]) == (promise["broken"], promise["bound"], promise["unit"])
            assert row["99 %"] == promise["quantiles"]["99"] or promise["quantiles"]["99"] is None
    data = found.dataset()
    counted = document["map"]["families"]["step"]
    np.testing.assert_array_equal(data["broken_step"], counted["broken"])
    np.testing.assert_array_equal(data["settling_s_step"], np.array(counted["worst_of"]["settling_s"], dtype=float))
    assert data["settling_s_step"].attrs["units"] == "s"
    edges = data.attrs["scr_edges"]
    assert all(a < b < c for a, b, c in zip(edges, data["scr"].values, edges[1:], strict=False))


@pytest.mark.parametrize("library", ["pandas", "xarray"])
def test_what_is_not_installed_is_told(library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(vd.VsgDesignError, match=rf'needs {library}, .* pip install "vsgdesign\[frames\]"'):
        vd.DesignedTable(gain_table(), {}).dataset()
