"""The field estimator beside a load and beside another converter: what happens, and that the pages say the figures."""

from __future__ import annotations

from pathlib import Path

from evidence.field_not_alone import CONDITIONS, measured

DOCS = Path(__file__).resolve().parents[2] / "docs"


def rows() -> dict[str, list[str]]:
    """The cells of the table on the page by what is beside the converter."""
    text = (DOCS / "field-estimator-evidence.md").read_text(encoding="utf-8")
    text = text.partition("<!-- evidence: field_not_alone -->")[2].partition("<!-- end of evidence -->")[0]
    cells = [[cell.strip() for cell in line.strip("| ").split("|")] for line in text.strip().splitlines()[2:]]
    return {name: rest for name, *rest in cells}


def test_a_load_is_told_or_in_the_answer_and_a_modulation_makes_doubt() -> None:
    loaded, told, shaken = (measured(list(CONDITIONS)[k], range(100000, 100001)) for k in (1, 2, 6))
    assert loaded["valid"] == 1.0
    assert loaded["coverage"] > 0.9
    assert told["valid"] == 0.0  # not a passive R-L-C grid
    assert shaken["valid"] < 0.9
    assert shaken["coverage"] > 0.9


def test_the_how_to_says_the_figures_of_the_table() -> None:
    found = rows()
    assert list(found) == list(CONDITIONS)
    page = " ".join((DOCS / "how-to" / "field-estimator.md").read_text(encoding="utf-8").split())
    for condition, sentence in {
        "a resistance of 0.5 pu": "{valid} of the cycles have a valid answer, {coverage} of these have the true Z in "
        "their 95 % ellipse, and the median error is {median}",
        "a resistance of 0.1 pu of power": "{coverage} have it, and the median error is {median}",
        "a modulation of 0.5 % at 25 Hz": "{valid} of the cycles have a valid answer, and the 95 % quantile of their "
        "errors is {p95}",
    }.items():
        _, valid, coverage, error = found[condition]
        median, p95 = error.split(", ")
        assert sentence.format(valid=valid, coverage=coverage, median=median, p95=p95) in page
