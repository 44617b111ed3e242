"""Changed gain tables and weights with right hashes: what does ``table check`` say, and which weights are read?

The table has four nodes, a gap-free certificate with steps, and 24 cases in EMT. The weights are the packaged ones of
the field estimator, and a random network of windows.
"""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner

from evidence._table_mutations import FIELD, TABLE, WINDOWS, Mutation, mutated
from evidence._tables import leave, table
from tests.artifacts.networks import random_weights
from tests.design.robust_studies import TEXT, robust_study
from vsgdesign.artifacts.field_weights import FIELD_WEIGHTS_FILE, PACKAGED
from vsgdesign.artifacts.gain_table_file import TABLE_FILE
from vsgdesign.artifacts.guarded_file import GuardedFile
from vsgdesign.artifacts.network_weights import WEIGHTS_FILE, weights_document
from vsgdesign.errors import ArtifactError
from vsgdesign.verbs.cli.program import main as command_line
from vsgdesign.verbs.pipeline.table import build_table_file

COUNT, SEED = 200, 2031


@dataclass(frozen=True)
class Outcome:
    """One changed file: the field, whether its fault follows from the file, and what was said."""

    kind: str
    field: str
    to_refuse: bool
    refused: bool
    good: bool
    named: bool
    """Whether the field is in the fault, or in the list of what is carried."""
    says: str

    @property
    def right(self) -> bool:
        """Refused with its field, or carried with its name and not called good."""
        return self.named and self.refused is self.to_refuse and not self.good


def checked(path: Path, text: str, mutation: Mutation, field: str) -> Outcome:
    """What ``table check`` says of a table."""
    path.write_text(text, encoding="utf-8")
    shown = CliRunner().invoke(command_line, ["table", "check", str(path)])
    if shown.exception is not None and not isinstance(shown.exception, SystemExit):
        raise shown.exception
    said = shown.output
    last = said.splitlines()[-1] if said else ""
    named = field in said if shown.exit_code else field in last and last.startswith("carried, not checked")
    return Outcome(mutation.name, field, mutation.refused, bool(shown.exit_code), ": good" in said, named, said)


def read(path: Path, text: str, mutation: Mutation, field: str, form: GuardedFile[Any]) -> Outcome:
    """What reading weights says."""
    path.write_text(text, encoding="utf-8")
    try:
        form.read(path)
    except ArtifactError as error:
        return Outcome(mutation.name, field, mutation.refused, True, False, field in str(error), str(error))
    return Outcome(mutation.name, field, mutation.refused, False, True, False, "")


def outcomes(
    document: dict[str, Any],
    kinds: Sequence[Mutation],
    count: int,
    seed: int,
    form: GuardedFile[Any],
    judge: Callable[[str, Mutation, str], Outcome],
) -> list[Outcome]:
    """``count`` changes of a document, every kind in turn."""
    rng, found = np.random.default_rng(seed), []
    for k in range(count):
        kind = kinds[k % len(kinds)]
        text, field = mutated(document, kind, rng, form)
        found.append(judge(text, kind, field))
    return found


def main(folder: Path) -> None:
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "table.json"
        build_table_file(robust_study(TEXT), path, workers=1, points=40, verify=24)
        document = json.loads(path.read_text(encoding="utf-8"))
        changed = Path(place) / "changed.json"
        found = outcomes(document, TABLE, COUNT - 40, SEED, TABLE_FILE, lambda t, m, f: checked(changed, t, m, f))
        for own, kinds, form in (
            (weights_document(random_weights()), WINDOWS, WEIGHTS_FILE),
            (json.loads(PACKAGED.read_text(encoding="utf-8")), FIELD, FIELD_WEIGHTS_FILE),
        ):
            found += outcomes(own, kinds, 20, SEED, form, lambda t, m, f, form=form: read(changed, t, m, f, form))
    counts = Counter(one.kind for one in found)
    rows = [
        (kind, str(count), *(str(sum(one.kind == kind and getattr(one, name) for one in found)) for name in NAMES))
        for kind, count in counts.items()
    ]
    total = (str(sum(getattr(one, name) for one in found)) for name in NAMES)
    lines = table(("what was changed", "files", *NAMES), [*rows, ("all", str(len(found)), *total)])
    leave(folder, "table_mutations", [vars(one) for one in found], lines)
    for one in found:
        if not one.right:
            print(f"WRONG: {one.kind}, {one.field}: {one.says}")


NAMES = ("to_refuse", "refused", "good", "right")
