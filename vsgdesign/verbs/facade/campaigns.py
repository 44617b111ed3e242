"""Campaigns: random cases, disturbances, grid-code tests and sizes of the dc side, as the verbs verify, survive, comply
and size run them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Unpack

from vsgdesign.execution.executors import How
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.shown import BRIDGES, Bridge, Shown, dataset_of, frame_of, given_study, known_word, names_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from vsgdesign.artifacts.ready import Ready
    from vsgdesign.report.drawing.figures import NamedFigure


Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class _Campaign(Shown):
    """The content of results.json, and the folder that has it with its page."""

    kind: ClassVar[str] = ""
    document: dict[str, Any]
    folder: Path

    @property
    def title(self) -> str:
        """What it is, and the study's title."""
        return f"{self.kind}: {self.document['title']}"

    @property
    def page(self) -> Path:
        """The page of the result."""
        return self.folder / "report.html"

    def to_dict(self) -> dict[str, Any]:
        """The content of results.json."""
        return self.document


@dataclass(frozen=True)
class Verification(_Campaign):
    """The result of :func:`verify`. It is true where cases were judged and no promise was broken."""

    kind = "Verification"

    def __bool__(self) -> bool:
        from vsgdesign.artifacts.verification_text import kept

        return kept(self.document)

    def sentences(self) -> Sequence[str]:
        """The answer, then one sentence for each promise, as on the page and the terminal."""
        from vsgdesign.artifacts.verification_text import headline, promise_sentences

        return [headline(self.document), *promise_sentences(self.document)]

    def frame(self) -> pd.DataFrame:
        """One row for each promise of each family of cases: how often it is broken, the bound of this share, its worst
        value and its quantiles, in its own ``unit``. Needs the extra ``frames``."""
        fields = ("figure", "limit", "unit", "broken", "judged", "share", "bound", "worst")
        promises = [(f, p, one) for f, it in self.document["families"].items() for p, one in it["promises"].items()]
        quantiles = list(dict.fromkeys(q for *_, one in promises for q in one["quantiles"]))
        rows = [
            [f, p, *(one[name] for name in fields), *(one["quantiles"].get(q) for q in quantiles)]
            for f, p, one in promises
        ]
        header = ["family", "promise", *fields[:5], "share [1]", "bound [1]", "worst", *(f"{q} %" for q in quantiles)]
        names = ("controller", "seed", "confidence")
        return frame_of(header, rows, **{name: self.document[name] for name in names})

    def dataset(self) -> xr.Dataset:
        """The map: for each family and bin of ``scr`` and ``x_over_r`` cases judged, cases that broke a promise, and
        the worst value of each figure. Coordinates are the middles of the bins; their edges are in the ``attrs``. Needs
        the extra ``frames``."""
        found, columns = self.document["map"], {}
        units = {
            one["figure"]: one["unit"] for it in self.document["families"].values() for one in it["promises"].values()
        }
        for family, counts in found["families"].items():
            columns |= {f"{name}_{family} [1]": counts[name] for name in ("judged", "broken")}
            columns |= {f"{name}_{family} [{units[name]}]": values for name, values in counts["worst_of"].items()}
        flat = [[value for row in values for value in row] for values in columns.values()]
        edges = {name: found[f"{name}_edges"] for name in ("scr", "x_over_r")}
        middles = [[math.sqrt(a * b) for a, b in itertools.pairwise(values)] for values in edges.values()]
        about = {f"{name}_edges": values for name, values in edges.items()} | {"scr_basis": found["scr_basis"]}
        frame = frame_of(list(columns), zip(*flat, strict=True), controller=self.document["controller"], **about)
        return dataset_of(frame, dict(zip(edges, middles, strict=True)))

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.report.verification.page import verification_figures

        yield from verification_figures(self.document)


@dataclass(frozen=True)
class Survival(_Campaign):
    """The result of :func:`survive`. It is true where nothing was lost."""

    kind = "Survival"

    def __bool__(self) -> bool:
        return not any(one["lost"] for one in self.document["variants"].values())

    def sentences(self) -> Sequence[str]:
        """How much each controller survives, as on the page."""
        from vsgdesign.report.survival import survival_sentences

        return survival_sentences(self.document)

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.report.survival import survival_figure

        yield survival_figure(self.document)


@dataclass(frozen=True)
class Compliance(_Campaign):
    """The result of :func:`comply`. It is true where no test fails."""

    @property
    def title(self) -> str:
        """The study's title."""
        return f"Grid-code tests: {self.document['study']['title'] or self.document['study']['name']}"

    def __bool__(self) -> bool:
        return not any(one["fail"] for one in self.document["summary"])

    def sentences(self) -> Sequence[str]:
        """The answer and what it rests on, as on the page."""
        from vsgdesign.report.compliance.answer import below_headline, dc_side_suffices, headline
        from vsgdesign.report.compliance.arranged import arrange

        arranged = arrange(self.document)
        return [headline(arranged), *below_headline(arranged), *dc_side_suffices(self.document)]

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.report.compliance.answer import counts_of_suites
        from vsgdesign.report.compliance.arranged import arrange

        yield counts_of_suites(arrange(self.document))


def _place(study: Study, out: str | Path | None, work: str) -> Path:
    """The folder that the verb takes where none is given."""
    return Path("out") / f"{study.name}-{work}" if out is None else Path(out)


def verify(
    study: Study | str | Path,
    out: str | Path | None = None,
    *,
    controller: str | None = None,
    table: str | Path | None = None,
    runs: int | None = None,
    seed: int | None = None,
    confidence: float | None = None,
    bridge: Bridge = "averaged",
    strict: bool = False,
    search: int | None = None,
    explorer: bool = True,
    progress: Progress | None = None,
    **how: Unpack[How],
) -> Verification:
    """Simulates random cases and bounds the share of failures, as ``vsgdesign verify`` does.

    The folder ``out`` (None: out/NAME-verification) gets the page, results.json and the worst cases as study files. An
    interrupted call continues with the same call. ``table`` is the file of a gain table that takes the place of the
    controller's. ``runs``, ``seed`` and ``confidence`` replace those of the study's [verification]; ``search`` is the
    number of further runs that search for worse cases (None: 5 % of the runs). ``how``: ``workers``, ``cluster``,
    ``fresh`` and ``say``, as in :class:`vsgdesign.execution.executors.How`. Raises the errors of
    :func:`vsgdesign.verbs.pipeline.verify.verify_study`.
    """
    from vsgdesign.verbs.pipeline.one_unit import as_one_converter, with_tables_left
    from vsgdesign.verbs.pipeline.verify import WORK, Asked, verify_study, with_table

    known_word("bridge", bridge, BRIDGES)
    if search is not None and search < 0:
        raise ValueError(f"search = {search}: must be 0 or more.")
    study = as_one_converter(given_study(study, "verify"))
    given = {"runs": runs, "seed": seed, "confidence": confidence}
    if changes := {name: value for name, value in given.items() if value is not None}:
        study.with_changes(verification=changes)  # the study's reader says what is wrong with them
    if table is None:
        study = with_tables_left(study)
    else:
        study, controller = with_table(study, table, controller)
    folder = _place(study, out, WORK)
    asked = Asked(
        controller=controller,
        runs=runs,
        seed=seed,
        confidence=confidence,
        bridge=bridge,
        strict=strict,
        search=search,
        explorer=explorer,
    )
    return Verification(verify_study(study, folder, asked, progress=progress, **how), folder)


def survive(
    study: Study | str | Path,
    out: str | Path | None = None,
    *,
    controllers: Sequence[str] | None = None,
    limiters: Sequence[str] | None = None,
    bridge: Bridge = "averaged",
    explorer: bool = True,
    progress: Progress | None = None,
    **how: Unpack[How],
) -> Survival:
    """Sends controllers through jumps, faults and phase steps, as ``vsgdesign survive`` does.

    The folder ``out`` (None: out/NAME-survival) gets the page, results.json and cases.csv. ``limiters`` replace the
    current limiter of the study one after the other; "none" is none. ``how`` is that of :func:`verify`. Raises the
    errors of :func:`vsgdesign.verbs.pipeline.survival.report_survival`.
    """
    from vsgdesign.verbs.pipeline.one_unit import as_one_converter, with_tables_left
    from vsgdesign.verbs.pipeline.survival import WORK, Asked, report_survival

    known_word("bridge", bridge, BRIDGES)
    study = with_tables_left(as_one_converter(given_study(study, "survive")))
    folder = _place(study, out, WORK)
    asked = Asked(names_of(controllers) or None, names_of(limiters) or None, bridge, explorer)
    return Survival(report_survival(study, folder, asked, progress=progress, **how), folder)


def comply(
    study: Study | str | Path,
    out: str | Path | None = None,
    *,
    suites: Sequence[str] = ("all",),
    controllers: Sequence[str] = (),
    maps: bool = True,
    cases: Literal["failing", "all", "none"] = "failing",
    comtrade: Literal["ascii", "binary", "float32", "cff"] | None = None,
    ready: Ready | None = None,
    progress: Progress | None = None,
    **how: Unpack[How],
) -> Compliance:
    """Runs suites of grid-code tests, as ``vsgdesign comply`` does.

    ``suites`` are names of packaged suites, paths of files of your own, or "all". The folder ``out`` (None:
    out/NAME-compliance) gets the page, results.json, the traces and the rows of ``cases`` as study files. ``maps``:
    whether survival maps are drawn. ``comtrade``: the form in which every run is also written as COMTRADE. ``ready``
    holds gain tables that are there. ``how`` is that of :func:`verify`. Raises the errors of
    :func:`vsgdesign.verbs.pipeline.comply.comply_study`.
    """
    from vsgdesign.artifacts.time_series import FORMS
    from vsgdesign.verbs.pipeline.comply import CASES, WORK, Asked, comply_study
    from vsgdesign.verbs.pipeline.one_unit import as_one_converter

    known_word("cases", cases, CASES)
    file = str(study) if isinstance(study, str | Path) else None
    study = as_one_converter(given_study(study, "comply"))
    folder = _place(study, out, WORK)
    if comtrade is not None:
        known_word("comtrade", comtrade, FORMS)
    asked = Asked(
        suites=names_of(suites), controllers=names_of(controllers), maps=maps, cases=cases, file=file, comtrade=comtrade
    )
    return Compliance(comply_study(study, folder, asked, ready=ready, progress=progress, **how), folder)


@dataclass(frozen=True)
class DcSide(_Campaign):
    """The result of :func:`size`. It is true where the full simulation confirms the sizes."""

    kind = "The dc side"

    def __bool__(self) -> bool:
        return bool(self.document["trials"][0]["survived"])

    def sentences(self) -> Sequence[str]:
        """The sizes, as on the page."""
        from vsgdesign.report.sizing import sizing_sentences

        return sizing_sentences(self.document)

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.report.sizing import sizing_figure

        yield sizing_figure(self.document)


def size(
    study: Study | str | Path,
    out: str | Path | None = None,
    *,
    controller: str | None = None,
    capacitor: float | None = None,
    source: str | None = None,
    keep: Mapping[str, float] | None = None,
    suites: Sequence[str] = (),
    progress: Callable[[str, float], None] | None = None,
) -> DcSide:
    """Finds the power, capacitor and energy that the dc side of a controller needs, as ``vsgdesign size`` does.

    The folder ``out`` (None: out/NAME-dc-side) gets the page and results.json. ``controller``: its name (None: the last
    one). ``capacitor``: the one with which the least power is found, F. ``source``: "converter" or "battery" (None:
    that of [dc], else "converter"). ``keep``: sizes that are given, such as {"power": 9e3}, also "capacitor" (F) and
    "energy" (J). ``suites``: names or files of
    grid-code tests in place of the study's events. Raises the errors of
    :func:`vsgdesign.verbs.pipeline.sizing.size_study`.
    """
    from vsgdesign.verbs.pipeline.one_unit import alone
    from vsgdesign.verbs.pipeline.sizing import WORK, size_study

    study = alone(given_study(study, "size"), "size")
    folder = _place(study, out, WORK)
    document = size_study(
        study,
        folder,
        controller=controller,
        C=capacitor,
        source=source,
        keep=keep,
        suites=names_of(suites),
        progress=progress,
    )
    return DcSide(document, folder)
