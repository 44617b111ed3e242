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


def write_pdf(page: Path, out_path: Path) -> Path:
    """Print a page of this room; nothing is fetched. Raises ArtifactError without the extra ``pdf``."""
    weasyprint = require_pdf()
    logger = logging.getLogger("weasyprint")
    level = logger.level
    # It warns of every property for screens that paper does not have.
    logger.setLevel(logging.CRITICAL)
    try:
        # Without a base address, so that no folder of this machine ends up in the file's links.
        weasyprint.HTML(string=page.read_text(encoding="utf-8"), url_fetcher=_refuse).write_pdf(str(out_path))
    finally:
        logger.setLevel(level)
    return out_path


def _refuse(url: str, *_args: Any, **_kwargs: Any) -> Any:
    if url.startswith("data:"):
        return importlib.import_module("weasyprint").default_url_fetcher(url)
    raise ValueError(f"a report holds everything itself, and does not fetch {url}")
