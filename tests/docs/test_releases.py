"""docs/releases.md states the schema that each reader has."""

from __future__ import annotations

import re
from pathlib import Path

from vsgdesign.artifacts import field_weights, gain_table, inner_loops_file, network_weights
from vsgdesign.artifacts.gain_table_file import TABLE_FILE
from vsgdesign.campaigns.verification import blocks
from vsgdesign.estimator import data_set
from vsgdesign.export import c_code
from vsgdesign.runtime import updating
from vsgdesign.study.parameters import building

PAGE = Path(__file__).resolve().parents[2] / "docs" / "releases.md"
READERS = {
    "study": building.SCHEMA,
    "gain table": gain_table.SCHEMA,
    "network weights": network_weights.SCHEMA,
    "weights of the field estimator": field_weights.SCHEMA,
    "designed inner loops": inner_loops_file.SCHEMA,
    "windows of an estimator": data_set.SCHEMA,
    "counts of `verify`": blocks.SCHEMA,
    "state of a scheduler": updating.SCHEMA,
    "manifest of exported C": c_code.SCHEMA,
}


def test_the_page_has_the_schema_of_each_reader() -> None:
    rows = re.findall(r"^\| ([^|]+) \| (\d+) \|", PAGE.read_text(encoding="utf-8"), re.M)
    assert {file: int(schema) for file, schema in rows if file != "`results.json`"} == READERS
    assert len(TABLE_FILE.upgrades) == gain_table.SCHEMA - 1  # every older one is read
