"""What all verbs share: arguments, exit codes, JSON and progress. Each function imports the heavy rooms that it
needs.
"""

from __future__ import annotations

import glob
import io
import json
import os
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import click

from vsgdesign.errors import VsgDesignError, visible
from vsgdesign.execution.signals import End, Stop, signals_raise

if TYPE_CHECKING:
    from vsgdesign.study.parameters import Study

EXIT_IMPOSSIBLE = 1
EXIT_WRONG_INPUT = 2

FILE = click.argument("file", metavar="STUDY.toml|TABLE.json", type=click.Path())
STUDY_OF_TABLE = click.option(
    "--study", "study_file", default=None, metavar="STUDY.toml", help="The study with the converter of TABLE.json."
)
STUDY = click.argument("study_file", metavar="STUDY.toml", type=click.Path())


def is_table(file: str) -> bool:
    """Whether a file is taken for a gain table, and not for a study."""
    return file.lower().endswith(".json")


def check_study_of(file: str, study_file: str | None) -> None:
    """Refuses a table without its study, and a study beside another one, where FILE may be either."""
    if is_table(file) and study_file is None:
        raise click.UsageError(f"{file} is no study. If it is a gain table, --study names the study with its converter")
    if study_file is not None and not is_table(file):
        raise click.UsageError("--study belongs to a TABLE.json; a study is given alone")


class Real(click.FloatRange):
    """A number within limits. NaN, which no comparison finds outside of them, is refused as well."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number, or click's error that names the limits."""
        number = super().convert(value, param, ctx)
        if number != number:
            self.fail(f"{number} is not in the range {self._describe_range()}.", param, ctx)
        return number


JSON = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on standard output.")
BRIDGE = click.option("--bridge", type=click.Choice(["averaged", "pwm"]), help="Override the study's bridge model.")
EXPLORER = click.option(
    "--explorer/--no-explorer",
    default=True,
    help="Also write what simulates in the browser, on which one drags the grid.  [default: yes]",
)

FULL_ORDER = click.option(
    "--full-order",
    type=Real(0.0),
    default=0.0,
    metavar="SECONDS",
    help="Time for the proof of each designed table's sampled full-order loop.  [default: 0, none is made]",
)

COMTRADE = click.option(
    "--comtrade",
    type=click.Choice(["ascii", "binary", "float32", "cff"]),
    default=None,
    help="Also write the time series as COMTRADE, with samples of this form.",
)

WORKERS = click.option(
    "--workers", type=click.IntRange(1), default=None, metavar="N", help="Number of processes.  [default: one per core]"
)
_CLUSTER = click.option(
    "--cluster", default=None, metavar="local|ADDRESS", help='A Dask cluster (needs the extra "cluster").'
)
_RESUME = click.option(
    "--resume/--fresh", default=True, help="Continue interrupted work, or begin again.  [default: resume]"
)


def in_blocks(function: Callable[..., None]) -> Callable[..., None]:
    """Give a verb the options of work in blocks, that several processes share and that continues after an
    interruption. It gets them as one argument ``how`` (:class:`vsgdesign.execution.executors.How`)."""

    @WORKERS
    @_CLUSTER
    @_RESUME
    @wraps(function)
    def wrapped(*args: Any, workers: int | None, cluster: str | None, resume: bool, **kwargs: Any) -> None:
        if cluster not in (None, "local") and workers is not None:
            raise click.UsageError(
                "--workers sets the processes of this machine; a cluster at an address has its own workers"
            )
        how = {"workers": workers, "cluster": cluster, "fresh": not resume, "say": echo_aside}
        function(*args, how=how, **kwargs)

    return wrapped


def echo_aside(sentence: str) -> None:
    """Print a sentence on standard error, beside the result."""
    click.echo(sentence, err=True)


def exit_code(error: VsgDesignError) -> int:
    from vsgdesign.errors import ArtifactError, StudyError

    return EXIT_WRONG_INPUT if isinstance(error, StudyError | ArtifactError) else EXIT_IMPOSSIBLE


def verb(function: Callable[..., None]) -> Callable[..., None]:
    """Turn the project's errors into one message on standard error and the documented exit code."""

    @wraps(function)
    def wrapped(*args: Any, **kwargs: Any) -> None:
        stop, end = Stop(), _end_of_process()
        try:
            with signals_raise() as stop:
                function(*args, **kwargs)
                if sys.stdout is not None:  # the caller has closed it
                    sys.stdout.flush()
                end.done()
        except KeyboardInterrupt:
            _end(end, f"{stop.word}: {end.words}", stop.exit_code)
        except Interrupted as interrupted:
            _end(end, f"{stop.word}: {interrupted}", stop.exit_code)
        except Exception as error:
            if stop.number is not None:  # what a signal met on its way made something else of it
                _end(end, f"{stop.word}: {end.words}", stop.exit_code)
            if isinstance(error, VsgDesignError):
                _end(end, f"error: {error}", exit_code(error))
            if not isinstance(error, OSError) or not _of_the_disk(error):
                raise
            _end(end, f"error: cannot write: {error.strerror}. Choose a place with enough space.", EXIT_WRONG_INPUT)

    return wrapped


def _end_of_process() -> End:
    """What a signal after the verb says; the program has given it."""
    context = click.get_current_context(silent=True)
    found = None if context is None else context.find_object(End)
    return found or End()


class Interrupted(Exception):
    """A signal has arrived, and the message must say more than that nothing was written."""


@contextmanager
def results_at(place: str | Path, kept: Callable[[], str] = lambda: "nothing was written") -> Iterator[None]:
    """Within the block, which writes results at a place and shows them, Ctrl-C says so if they are there already, and
    otherwise what ``kept`` says."""
    before = _identity(place)
    try:
        yield
    except KeyboardInterrupt:
        if _identity(place) not in (None, before):
            raise Interrupted(f'the results are complete, in "{place}"') from None
        raise Interrupted(kept()) from None


def going_on(
    found: Mapping[str, Any] | None, table_file: str | Path, study_file: str, follows: bool = True
) -> str | None:
    """How a full-order proof goes on that was not finished in its time; None where there is none, where it is finished,
    or where none can be made. ``follows``: whether a controller of the study takes its gains from a table."""
    from vsgdesign.artifacts.table_text import full_order_complete

    if found is None or full_order_complete(found) or "reason" in found or not found.get("decay"):
        return None
    # Without a decay a pair takes those of its own search, which are the same again.
    decay = "" if "differential" in found else f" --decay {found['decay']!r}"
    files = f"{shlex.quote(str(table_file))} --study {shlex.quote(study_file)}"
    command = f"vsgdesign certify {files} --model full{decay}"
    proved = min(found["proved"], found.get("differential", found)["proved"])
    done = f"full-order proof: {100.0 * proved:.3g} % of the region"
    return f"{done}; {command} goes on" if follows else f"{done}; a study that uses the table can go on"


def kept_words(place: str | Path, work: str, what: str) -> str:
    """What is said of the finished things ("test") that some work keeps beside the place of its results."""
    from vsgdesign.execution.journal import kept_count

    count = kept_count(place, work)
    if not count:
        return "nothing was written"
    what = f"1 finished {what} is" if count == 1 else f"{count:,} finished {what}s are"
    return f"{what} kept; the same command continues there"


def _identity(place: str | Path) -> tuple[int, int, int] | None:
    """What tells a file or folder from another one that takes its place; None where there is none."""
    try:
        found = os.stat(place)
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_mtime_ns


def keeping(folder: str | Path) -> AbstractContextManager[None]:
    """As :func:`results_at`, which otherwise says whether finished work is kept beside the ``folder``."""

    def kept() -> str:
        place = Path(os.path.realpath(folder))
        beside = (place.with_name(f".{place.name}.survival"), *place.parent.glob(f".{glob.escape(place.name)}.*.cells"))
        if any(True for one in beside for _ in one.glob("*.json*")):
            return "no results were written; finished work is kept, and the same command continues there"
        return "nothing was written"

    return results_at(folder, kept)


def _end(end: End, message: str, code: int) -> NoReturn:
    """Print a last line on standard error, which may be gone with its terminal, and end with the exit code."""
    end.said(code)
    with suppress(OSError):
        click.echo(visible(message), err=True)
    stdout = sys.stdout
    if stdout is not None:  # the caller has closed it
        try:
            stdout.flush()
        except OSError:  # a full disk: what is left in the buffer would be tried again, and complained of, at the exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), stdout.fileno())
    sys.exit(code)


def _of_the_disk(error: OSError) -> bool:
    from vsgdesign.artifacts.files import OF_THE_DISK

    return error.errno in OF_THE_DISK


Plants = Literal["refused", "as one unit", "whole"]
"""What a verb makes of a plant of several converters."""


def load(study_file: str, quiet: bool = False, *, left_tables: bool = False, plants: Plants = "refused") -> Study:
    """Load the study of a file. If it leaves its inner loops to be designed, they are designed once and kept beside
    it. With ``left_tables``, a gain table of the same design that an earlier command has left below ``out`` is taken.
    ``plants``: whether a plant of several converters is refused, as of a verb that knows one, or becomes one of its
    equal units (:func:`vsgdesign.verbs.pipeline.plant.as_unit`), or stays as it is.
    """
    from vsgdesign.study.parameters.power_plant import one_converter
    from vsgdesign.verbs.pipeline.one_unit import as_one_converter, as_unit
    from vsgdesign.verbs.pipeline.opening import open_study

    what = f"vsgdesign {_verb_name()}"
    with progress(quiet) as report:
        study = as_one_converter(open_study(study_file, progress=report, say=echo_aside))
    if plants == "refused":
        one_converter(study, what)
    if plants == "as one unit":
        study = as_unit(study, what)
    if left_tables:
        from vsgdesign.verbs.pipeline.one_unit import with_tables_left

        study = with_tables_left(study, say=echo_aside)
    return study


def _verb_name() -> str:
    """The verb that runs, as it is written after the program's name."""
    names, context = [], click.get_current_context()
    while context.parent is not None:
        names.append(context.info_name or "")
        context = context.parent
    return " ".join(reversed(names))


def streams_can_print() -> None:
    """A character that standard output cannot write, such as ≤ in a file of Windows or in the locale C, becomes a
    question mark. It ended a verb with a traceback after all its work.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="replace")


def print_json(document: Any) -> None:
    """Print a document as JSON on standard output, with escapes where its encoding has not every character."""
    from vsgdesign.artifacts.files import plain

    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    escapes = encoding.casefold().replace("-", "") != "utf8"
    click.echo(json.dumps(plain(document), indent=1, ensure_ascii=escapes))


@contextmanager
def progress(quiet: bool) -> Iterator[Callable[[str, float], None] | None]:
    """Show a progress bar for each stage on standard error, with the time left, if that is a terminal."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from vsgdesign.verbs.cli.bars import progress_bars

    with progress_bars() as report:
        yield report
