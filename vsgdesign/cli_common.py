"""What every verb shares: arguments, exit codes, JSON, progress. Heavy rooms are imported by who needs them."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import TYPE_CHECKING, Any

import click

from vsgdesign.errors import VsgDesignError

if TYPE_CHECKING:
    from vsgdesign.parameters import Study

EXIT_IMPOSSIBLE = 1
EXIT_WRONG_INPUT = 2
EXIT_INTERRUPTED = 130

STUDY = click.argument("study_file", metavar="STUDY.toml", type=click.Path())
JSON = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on standard output.")
BRIDGE = click.option("--bridge", type=click.Choice(["averaged", "pwm"]), help="Override the study's bridge model.")


def _exit_code(error: VsgDesignError) -> int:
    from vsgdesign.errors import ArtifactError, StudyError

    return EXIT_WRONG_INPUT if isinstance(error, StudyError | ArtifactError) else EXIT_IMPOSSIBLE


def verb(function: Callable[..., None]) -> Callable[..., None]:
    """Turns the project's errors into one message on standard error and the documented exit code."""

    @wraps(function)
    def wrapped(*args: Any, **kwargs: Any) -> None:
        try:
            function(*args, **kwargs)
        except VsgDesignError as error:
            click.echo(f"error: {error}", err=True)
            sys.exit(_exit_code(error))
        except KeyboardInterrupt:
            click.echo("interrupted: nothing was written", err=True)
            sys.exit(EXIT_INTERRUPTED)

    return wrapped


def load(study_file: str, quiet: bool = False) -> Study:
    """The study of a file. Inner loops that it leaves to be designed are designed, once, and kept beside it."""
    from vsgdesign.pipeline.opening import open_study

    def say(sentence: str) -> None:
        click.echo(sentence, err=True)

    with progress(quiet) as report:
        return open_study(study_file, progress=report, say=say)


def print_json(document: Any) -> None:
    """A document as JSON on standard output."""
    from vsgdesign.artifacts.files import plain

    click.echo(json.dumps(plain(document), indent=1, ensure_ascii=False))


@contextmanager
def progress(quiet: bool) -> Iterator[Callable[[str, float], None] | None]:
    """A progress bar per stage on standard error where that is a terminal."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from vsgdesign.console import progress_bars

    with progress_bars() as report:
        yield report
