"""Ctrl-C at each moment of the verbs that write: one line, exit code 130, and the truth about what is there."""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.cli.small_studies import call, study_file
from vsgdesign.execution.jobs import begun
from vsgdesign.verbs.pipeline import live_part, margins

WRITING = {
    "report": "vsgdesign.verbs.pipeline.report_stability",
    "run": "vsgdesign.verbs.pipeline.run_study",
    "inner": "vsgdesign.verbs.pipeline.inner.report_inner_loops",
    "estimator compare": "vsgdesign.verbs.pipeline.estimators.report_comparison",
    "estimator stress": "vsgdesign.verbs.pipeline.estimators.report_stress",
    "estimator train": "vsgdesign.verbs.pipeline.estimators.train_weights_file",
}


@pytest.mark.parametrize("written", [False, True])
@pytest.mark.parametrize("verb", WRITING)
def test_a_signal_before_and_after_the_results_are_in_place(
    verb: str, written: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After the folder was in its place, it was said that nothing was written."""
    out = tmp_path / "results"

    def work(*_: object, **__: object) -> None:
        if written:
            out.mkdir()
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(WRITING[verb], work)
    result = call(*verb.split(), study_file(tmp_path), "--out", out)
    said = f'the results are complete, in "{out}"' if written else "nothing was written"
    assert (result.exit_code, result.stderr) == (130, f"interrupted: {said}\n")


@dataclass(frozen=True)
class Assessed:
    """What the report needs of an assessment before it writes anything."""

    study: Any
    ready: Any = None
    whole: Any = None


@pytest.mark.parametrize("later_s", [0.0, 1.0])
def test_a_signal_while_another_process_makes_the_explorer(
    later_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """While that process starts, and while the report waits for it: it ends, and shows no traceback of its own."""

    def interrupt(*_: object) -> None:
        threading.Timer(later_s, signal.pthread_kill, (threading.get_ident(), signal.SIGINT)).start()

    monkeypatch.setattr(margins, "assess_study", lambda study, **_: Assessed(study))
    monkeypatch.setattr(live_part, "worker_count", lambda _: 2)
    monkeypatch.setattr(live_part, "begun", lambda executor, *_, **__: begun(executor, time.sleep, 60.0))
    monkeypatch.setattr(margins, "write_stability_tables", interrupt)
    monkeypatch.setattr("vsgdesign.report.stability.page.stability_figures", lambda *_: [])
    begin = time.monotonic()
    result = call("report", study_file(tmp_path), "--out", tmp_path / "results")
    assert (result.exit_code, result.stderr) == (130, "interrupted: nothing was written\n")
    assert time.monotonic() - begin < 50.0
    assert capfd.readouterr() == ("", "")
    assert not multiprocessing.active_children()
    assert [path.name for path in tmp_path.iterdir()] == ["small.toml"]
