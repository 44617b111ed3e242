"""The verb that checks a study and its files."""

from __future__ import annotations

import sys

import click

from vsgdesign.cli.common import EXIT_WRONG_INPUT, JSON, STUDY, print_json, verb
from vsgdesign.errors import counted


@click.command()
@STUDY
@JSON
@verb
def validate(study_file: str, as_json: bool) -> None:
    """Check a study and its files, and report all faults at once."""
    from vsgdesign.errors import StudyError
    from vsgdesign.pipeline.opening import check_named_files, check_study

    try:
        study, inner_loops = check_study(study_file)
        check_named_files(study, study_file)
    except StudyError as error:
        if not as_json:
            raise
        faults = [vars(fault) for fault in error.faults]
        print_json({"valid": False, "source": error.source, "faults": faults})
        sys.exit(EXIT_WRONG_INPUT)
    if as_json:
        document = {"valid": True, "study": study.name, "hash": study.hash}
        print_json(document | ({"inner_loops": inner_loops} if inner_loops else {}))
    else:
        counts = [(len(study.controllers), "controller"), (len(study.events), "event")]
        shown = ", ".join(counted(count, word) for count, word in counts)
        click.echo(f"{study_file}: valid ({shown})")
        if inner_loops:
            click.echo(inner_loops)
