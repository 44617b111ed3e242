"""vsgdesign cite: what a study or a result is behind, and the same names in its citation file."""

from __future__ import annotations

import json
import re
from importlib import metadata
from pathlib import Path

import pytest

from tests.cli.small_studies import call, failure, study_file
from vsgdesign import __version__
from vsgdesign.equations.limiters import LIMITERS
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.identification.interface import ESTIMATORS
from vsgdesign.verbs.pipeline.given_results import PAPERS, references

ROOT = Path(__file__).resolve().parents[2]


def entries(text: str) -> dict[str, str]:
    """Entries of BibTeX by their keys; each begins a line and ends with a closing brace on a line of its own."""
    found = re.findall(r"^(@\w+\{(\w+),\n(?:  \w+ = \{.*\},\n)+\})$", text, re.M)
    assert sum(map(len, (entry for entry, _ in found))) + 2 * len(found) - 1 == len(text)
    assert all(entry.count("{") == entry.count("}") for entry, _ in found)
    return {key: entry for entry, key in found}


def test_a_study_cites_what_it_uses_and_nothing_else(tmp_path: Path) -> None:
    path = study_file(tmp_path)
    found = entries(call("cite", path, "--bibtex").stdout)
    assert set(found) == {"vsgdesign", "hoang2025", "numpy", "scipy", "llvmlite", "control"}
    assert f"note = {{version {metadata.version('numpy')} was used}}" in found["numpy"]
    text = path.read_text(encoding="utf-8").replace('"small"', '"small"\nsource = "own data"')
    text = text.replace('kind = "fixed"', 'kind = "fixed"\nstructure = "angle_damped"')
    more = ('structure = "decoupled"', 'estimate = "rls"', 'current_limiter = "hybrid"', "current_limit_pu = 1.2")
    text = text.replace('kind = "scheduled"', "\n".join(('kind = "scheduled"', *more)))
    (tmp_path / "other.toml").write_text(text, encoding="utf-8")
    said = call("cite", tmp_path / "other.toml").stdout
    assert "hoang2025" not in said
    assert "fortescue1981: estimate rls of scheduled." in said
    assert "baeckeland2023: current limiter hybrid of scheduled." in said


def test_a_result_names_the_versions_that_made_it(tmp_path: Path) -> None:
    assert call("simulate", study_file(tmp_path), "--out", tmp_path / "out").exit_code == 0
    of_folder = call("cite", tmp_path / "out").stdout
    assert f"version {__version__}" in of_folder
    document = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    document["provenance"]["numpy"] = "0.0.7"
    (tmp_path / "old.json").write_text(json.dumps(document), encoding="utf-8")
    assert "version 0.0.7" in call("cite", tmp_path / "old.json").stdout
    document["study"]["inputs"]["controllers"] = 3
    (tmp_path / "old.json").write_text(json.dumps(document), encoding="utf-8")
    assert "not as vsgdesign writes it" in failure(2, "cite", tmp_path / "old.json")
    del document["study"]
    (tmp_path / "old.json").write_text(json.dumps(document), encoding="utf-8")
    assert "names no study" in failure(2, "cite", tmp_path / "old.json")


def test_what_is_no_study_and_no_result_is_told(tmp_path: Path) -> None:
    assert "there is no such file" in failure(2, "cite", tmp_path / "no.toml")
    assert "Give a results.json" in failure(2, "cite", tmp_path)


@pytest.mark.parametrize(("field", "name"), PAPERS)
def test_every_paper_belongs_to_something(field: str, name: str) -> None:
    cases = (ROOT / "vsgdesign" / "study" / "parameters" / "cases").glob("*.toml")
    there = {"structure": STRUCTURES, "estimate": ESTIMATORS, "current_limiter": LIMITERS}
    if field == "source":
        assert any(f'source = "{name}' in case.read_text(encoding="utf-8") for case in cases)
    else:
        assert name in there[field]
    assert PAPERS[field, name] in references()


def test_the_project_cites_itself_in_one_way() -> None:
    cff = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    known = references()
    titles = [known[key]["title"].replace("{", "").replace("}", "") for key in ("vsgdesign", "hoang2025")]
    assert re.findall(r'^ *title: "?(.*?)"?$', cff, re.M) == titles
    families = re.findall(r"family-names: (\w+)", cff)
    assert families == [author.partition(",")[0] for author in known["hoang2025"]["author"].split(" and ")]
