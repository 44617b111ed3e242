"""docs/theory/measures.md against the registry: every measure with its unit, sentence, range and parameters."""

from __future__ import annotations

from pathlib import Path

from vsgdesign.campaigns.compliance.measures import MEASURES, Measure

PAGE = Path(__file__).resolve().parents[2] / "docs" / "theory" / "measures.md"


def row_of(measure: Measure) -> str:
    """The measure's row of the page's table."""
    parameters = ", ".join(
        f"`{one.name}` = {one.default:g}{' ' * bool(one.unit)}{one.unit} ({one.least:g} to {one.most:g})"
        for one in measure.parameters
    )
    text = measure.text.replace("|", "\\|")
    low, high = measure.values
    return f"| `{measure.name}` | {measure.unit or '–'} | {text} | {low:g} to {high:g} | {parameters} |"


def test_the_table_is_that_of_the_registry() -> None:
    shown = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    assert shown == [row_of(measure) for measure in MEASURES.values()]
