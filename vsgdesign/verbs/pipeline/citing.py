"""The papers and versions behind what a run used, from its study or from its result."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from importlib import metadata, resources
from pathlib import Path
from typing import Any, NamedTuple

from vsgdesign.artifacts.folders import RESULTS
from vsgdesign.artifacts.provenance import provenance
from vsgdesign.equations.structures import PUBLISHED
from vsgdesign.errors import ArtifactError
from vsgdesign.verbs.pipeline.diff import read_result
from vsgdesign.verbs.pipeline.opening import check_study

_ALWAYS = {"numpy": "arrays", "scipy": "numerical methods", "llvmlite": "machine code of the simulation"}
_LETTERS = {"{\\'c}": "ć", '{\\"a}': "ä", "{\\'e}": "é", "--": "–", "{": "", "}": ""}
"""How BibTeX writes what is read here."""
PAPERS = {
    ("structure", "published"): "hoang2025",
    ("estimate", "neural"): "hoang2025",
    ("estimate", "rls"): "fortescue1981",
    ("estimate", "prbs"): "vandenbos1979",
    ("current_limiter", "hybrid"): "baeckeland2023",
    ("source", "Hoang"): "hoang2025",
    ("source", "Pogaku"): "pogaku2007",
    ("source", "D'Arco"): "darco2015",
}
"""What of a study comes from which paper. A source of data is known by the name with which it begins."""
_OF_VERBS = {
    "vsgdesign comply": {"hua1990": "modes of a run"},
    "vsgdesign verify": {"clopper1934": "bound of a share"},
    "vsgdesign run": {"control": "margins"},
    "vsgdesign report": {"control": "margins"},
}


class Citation(NamedTuple):
    """A paper or a program, and what it was used for."""

    key: str
    use: str
    version: str
    """Empty for a paper, and for a program whose version the result does not name."""
    fields: Mapping[str, str]
    """Those of an entry of BibTeX, with its ``type``."""

    def text(self) -> str:
        """Two lines: the key and its use, and the work itself."""
        authors = self.fields["author"].replace(" and others", " et al.").replace(" and ", "; ")
        version = f"version {self.version}" if self.version else ""
        rest = (self.fields.get(name, "") for name in ("journal", "booktitle", "note", "volume", "pages", "year"))
        work = ", ".join(part for part in (f'{authors}: "{self.fields["title"]}"', version, *rest) if part)
        for written, letter in _LETTERS.items():
            work = work.replace(written, letter)
        return f"{self.key}: {self.use}.\n  {work}."

    def bibtex(self) -> str:
        """The entry. The version of a program whose paper is cited stands in its note."""
        fields = {name: text for name, text in self.fields.items() if name != "type"}
        if self.version:
            named = "version" if self.fields["type"] == "software" else "note"
            text = self.version if named == "version" else f"version {self.version} was used"
            fields[named] = f"{fields[named]}; {text}" if named in fields else text
        lines = "".join(f"  {name} = {{{text}}},\n" for name, text in fields.items())
        return f"@{self.fields['type']}{{{self.key},\n{lines}}}"


def references() -> dict[str, dict[str, str]]:
    """Every entry that can be cited, by its key."""
    return tomllib.loads(
        resources.files("vsgdesign.verbs.pipeline").joinpath("references.toml").read_text(encoding="utf-8")
    )


def cite(path: str | Path) -> list[Citation]:
    """What to cite for a study file, a folder of results or its ``results.json``, this program first.

    A result names the versions that it was made with, and a study those that are installed. Raises StudyError for a
    study that is wrong, and ArtifactError for a file that is no result of a study.
    """
    path = Path(path)
    if path.is_dir() or path.suffix == ".json":
        document = read_result(path / RESULTS if path.is_dir() else path)
        study, versions, kind = document.get("study"), document.get("provenance"), document["kind"]
        if not isinstance(study, dict) or not isinstance(versions, dict):
            raise ArtifactError(
                f'"{path}" is a result of "{kind}", which names no study. Give a study, or a result of vsgdesign run.'
            )
        versions = {name: str(version) for name, version in versions.items()}
    else:
        found, _ = check_study(path)
        study, versions, kind = found.identity, _installed(), "vsgdesign run"
    entries, uses = references(), dict[str, list[str]]()
    try:
        for key, use in _used(study, kind):
            uses.setdefault(key, []).append(use)
    except (AttributeError, KeyError, TypeError) as error:
        raise ArtifactError(f'"{path}": the study in it is not as vsgdesign writes it. Give the original.') from error
    return [
        Citation(key, "; ".join(dict.fromkeys(uses[key])), versions.get(key, ""), entry)
        for key, entry in entries.items()
        if key in uses
    ]


def _installed() -> dict[str, str]:
    with suppress(metadata.PackageNotFoundError):
        return provenance() | {"torch": metadata.version("torch")}
    return provenance()


def _used(study: Mapping[str, Any], kind: str) -> Iterator[tuple[str, str]]:
    """Keys of entries, and what each was used for."""
    yield "vsgdesign", f"made the results of {kind}"
    yield from _ALWAYS.items()
    yield from _OF_VERBS.get(kind, {}).items()
    inputs = study.get("inputs") or {}
    if "verification" in inputs:
        yield "clopper1934", "bound of a share"
    if source := str(study.get("source") or ""):
        yield from (
            (key, f"data of the converter ({source})")
            for (field, name), key in PAPERS.items()
            if field == "source" and source.startswith(name)
        )
    if _part(inputs, "inner_loops").get("design") is True:
        yield "cmaes", "design of the inner loops"
    default = {
        "structure": _part(inputs, "power_loops").get("structure", PUBLISHED.name),
        "current_limiter": _part(inputs, "converter").get("current_limiter"),
    }
    controllers = [default | own for own in inputs.get("controllers", ())]
    for (field, value), key in PAPERS.items():
        if names := [own["name"] for own in controllers if own.get(field) == value]:
            yield key, f"{field.replace('_', ' ')} {value} of {', '.join(names)}"
    if "weights" not in _part(inputs, "estimator") and any(own.get("estimate") == "neural" for own in controllers):
        yield "torch", "training of the network"
    if names := ", ".join(own["name"] for own in controllers if own.get("schedule") == "table"):
        yield from ((key, f"gain table of {names}") for key in ("casadi", "ipopt"))
        yield from ((key, f"certificate of {names}") for key in ("clarabel", "cvxpy"))


def _part(inputs: Mapping[str, Any], section: str) -> Mapping[str, Any]:
    return inputs.get(section, {})
