"""A report as PDF, with the optional extra ``pdf``."""

from __future__ import annotations

import importlib
import logging
from pathlib import Path
from typing import Any

from vsgdesign.errors import ArtifactError

MISSING_EXTRA = 'a PDF needs WeasyPrint, which is not installed: pip install "vsgdesign[pdf]", or leave --pdf out.'
MISSING_LIBRARY = (
    "WeasyPrint does not find the Pango library that a PDF needs: install it with the system's packages (Debian and "
    "Ubuntu: apt install libpango-1.0-0 libpangoft2-1.0-0, macOS: brew install pango), or leave --pdf out."
)


def require_pdf() -> Any:
    """The printing library. Raises ArtifactError, which says what to install, where it is missing."""
    try:
        return importlib.import_module("weasyprint")
    except ImportError as error:
        raise ArtifactError(MISSING_EXTRA) from error
    except OSError as error:  # its own libraries are loaded on import
        raise ArtifactError(MISSING_LIBRARY) from error


class _Failures(logging.Handler):
    """Remembers what could not be printed."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())


def write_pdf(page: Path, out_path: Path) -> Path:
    """Print a page of this room; nothing is fetched.

    Raises ArtifactError without the extra ``pdf``, and where a part of the page cannot be printed.
    """
    weasyprint = require_pdf()
    logger, failures = logging.getLogger("weasyprint"), _Failures()
    level, propagate = logger.level, logger.propagate
    # It warns of every property that paper does not have; a figure that is left out is an error to it.
    logger.setLevel(logging.ERROR)
    logger.propagate = False
    logger.addHandler(failures)
    try:
        # Without a base address, so that no folder of this machine ends up in the file's links.
        fetcher = weasyprint.URLFetcher(allowed_protocols=["data"])
        weasyprint.HTML(string=page.read_text(encoding="utf-8"), url_fetcher=fetcher).write_pdf(str(out_path))
    finally:
        logger.removeHandler(failures)
        logger.setLevel(level)
        logger.propagate = propagate
    if failures.messages:
        raise ArtifactError(f"the PDF would be incomplete: {failures.messages[0]}. The HTML page is complete.")
    return out_path
