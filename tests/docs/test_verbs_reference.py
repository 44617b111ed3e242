"""docs/verbs.md against the program: every verb and option once, in its own words, and a short help that is whole."""

from __future__ import annotations

from pathlib import Path

import click
import pytest

from vsgdesign.verbs.cli.program import main
from website.verbs import GUIDES, PAGE, rendered, verbs

ROOT = Path(__file__).resolve().parents[2]
GROUPS = {"": main} | {name: one for name, one in main.commands.items() if isinstance(one, click.Group)}


def test_the_page_is_that_of_the_program() -> None:
    assert PAGE.read_text(encoding="utf-8") == rendered(), "write it again: python -m website.verbs"


def test_every_verb_is_shown_at_work() -> None:
    """The page that the reference names uses the verb."""
    assert set(GUIDES) == {name for name, _ in verbs()}
    for name, link in GUIDES.items():
        guide = ROOT / "docs" / link.partition("(")[2].rstrip(")")
        assert f"vsgdesign {name} " in guide.read_text(encoding="utf-8").replace("\n", " "), (name, guide)


@pytest.mark.parametrize("group", GROUPS)
def test_no_summary_is_cut_off(group: str) -> None:
    """In 80 columns, ``--help`` ends a summary that is too long with three dots."""
    # With the names of the help option: click keeps the option that it makes first.
    context = click.Context(GROUPS[group], info_name="vsgdesign", terminal_width=80, **main.context_settings)
    listed = GROUPS[group].get_help(context).partition("Commands:")[2]
    assert listed
    assert "..." not in listed


def test_every_option_says_what_it_means() -> None:
    for name, verb in verbs():
        for option in verb.params:
            if isinstance(option, click.Option):
                assert option.help, (name, option.name)
                assert not option.help.startswith("["), (name, option.name)
