"""The terminal, the page and results.json of a verification say the same numbers."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from tests.verification_documents import document
from vsgdesign.report.page.terminal import print_terminal
from vsgdesign.report.verification.page import SHOWN, verification_page, write_verification_page


class Text(HTMLParser):
    """The rows of the tables of a page, and its list items."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.items: list[str] = []
        self._into: list[str] | None = None
        self.feed(source)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:  # noqa: ARG002
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "li"):
            self._into = self.rows[-1] if tag == "td" else self.items
            self._into.append("")

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "li"):
            self._into = None

    def handle_data(self, data: str) -> None:
        if self._into is not None:
            self._into[-1] += data


def squeezed(text: str) -> str:
    return re.sub(r"\s+", " ", text)


@pytest.mark.parametrize("broken", [True, False])
def test_terminal_page_and_document_agree(broken: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = document(broken=broken)
    results = json.loads(json.dumps(made, allow_nan=False))
    print_terminal(verification_page(results).blocks)
    terminal = squeezed(capsys.readouterr().out)
    write_verification_page(results, tmp_path)
    page = Text((tmp_path / "report.html").read_text(encoding="utf-8"))
    asked = {(row[0], row[1].split(" ≤")[0].split(":")[0]): row for row in page.rows if len(row) == 11}
    checked = 0
    titles = {"overshoot": "Overshoot", "settling": "Settling time", "survival": "Survival", "current": "Peak current"}
    families = {"step": "Steps of Pref or Qref", "grid": "Jumps of the grid"}
    for family_name, family in results["families"].items():
        for name, promise in family["promises"].items():
            row = asked[families[family_name], titles[name]]
            assert int(row[2].replace(",", "")) == promise["broken"]
            assert int(row[3].replace(",", "")) == promise["judged"]
            assert row[5] == f"1 in {promise['one_in']:,}"
            if promise["worst"] is None:
                assert row[10] == "∞"
            else:
                shown = float(row[10].split()[0]) * (0.01 if name == "overshoot" else 1.0)
                assert shown == pytest.approx(promise["worst"], rel=5e-3)
            # The same texts, cell by cell, are in one line of the terminal.
            assert " ".join(row[2:]) in terminal, row
            checked += 1
    assert checked == 5
    for item in page.items[:checked]:
        assert item.replace("Pref", "P_ref") in terminal
    links = [row for row in page.rows if len(row) >= 5 and re.fullmatch(r"\d+", row[0])]
    assert len(links) == len(results["worst"]) + len(results["search"]["found"])
    assert f"… and {len(results['worst']) - SHOWN} more on the page" in terminal
    assert "these do not count in the share" in terminal
    assert "Why" not in terminal  # the page has the reasons; in a terminal each took up to ten lines
    assert f"{results['runs']:,} runs, seed {results['seed']}, AVX-512, 2 workers" in terminal
