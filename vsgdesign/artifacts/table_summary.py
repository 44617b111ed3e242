"""The summary of a gain table, with the same figures in results.json, on the terminal and on the page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from vsgdesign.artifacts.design_inputs import study_differences
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.table_text import between_text, causes_text, certificate_summary, status_text
from vsgdesign.artifacts.verification_text import table_verification
from vsgdesign.parameters.study import Study


def table_summary(study: Study, table: GainTable) -> dict[str, Any]:
    """A table of a study in JSON's types: hashes, proof, look between the nodes, causes, cells by status."""
    statuses, counts = np.unique(table.status, return_counts=True)
    return {
        "sha256": table.sha256,
        "design_hash": table.design_hash,
        "certificate": certificate_summary(table.certificate),
        "between": table.between,
        "causes": table.causes,
        "verification": table.verification,
        "not_of_this_study": study_differences(table, study),
        "nodes": list(table.shape),
        "status": dict(zip(statuses.tolist(), counts.tolist(), strict=True)),
    }


def table_lines(name: str, table: dict[str, Any]) -> Iterator[str]:
    """The same in words: what is proved (first where that failed), its cells, the look between its nodes, and where it
    was designed from something else than this study."""
    proof = table["certificate"]
    if proof["certified"] is False:
        yield f"{name}: {proof['text']}"
    yield f"{name}: gain table of {table['nodes'][0]} SCR × {table['nodes'][1]} X/R, {status_text(table['status'])}"
    if table["causes"]:
        yield f"why cells are relaxed: {causes_text(table['causes'])} (table show has each)"
    yield between_text(table["between"])
    if proof["certified"] is not False:
        yield proof["text"]
    if table.get("verification") is not None:  # summaries of before have none
        yield from table_verification(table["verification"])
    if table["not_of_this_study"]:
        yield f"the table was not designed from this study: {'; '.join(table['not_of_this_study'])}"
