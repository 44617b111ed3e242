"""A new text file: whole or not at all, and never in the place of one that is there."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from vsgdesign.errors import ArtifactError


def check_new(path: str | Path) -> Path:
    """The path, if a file can be made there. Raises ArtifactError."""
    path = Path(path)
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:  # a name too long, a folder that may not be entered, a NUL
        reason = getattr(error, "strerror", None) or error
        raise ArtifactError(f'cannot write "{path}": {reason}. Give another file.') from None
    if path.is_dir():
        raise ArtifactError(f'"{path}" is a folder; give a file, for example {path / "study.toml"}.')
    if path.exists() or path.is_symlink():
        raise ArtifactError(f'"{path}" already exists and was left untouched; give another file.')
    if not path.parent.is_dir():
        raise ArtifactError(f'there is no folder "{path.parent}"; make it, or give a file in another one.')
    if not os.access(path.parent, os.W_OK):
        raise ArtifactError(f'cannot write into "{path.parent}": permission denied. Give a file in another folder.')
    return path


def write_new_text(path: str | Path, text: str) -> None:
    """UTF-8 text into a file that must not be there yet. Raises ArtifactError."""
    path = check_new(path)
    name = ""
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name[:60]}.", dir=path.parent)
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as stream:
            stream.write(text)
        os.chmod(name, 0o644)
        os.link(name, path)  # unlike a rename it fails where somebody else was quicker
    except FileExistsError:
        raise ArtifactError(f'"{path}" already exists and was left untouched; give another file.') from None
    except OSError as error:
        raise ArtifactError(f'cannot write "{path}": {error.strerror}. Give a file in another folder.') from None
    finally:
        if name:
            Path(name).unlink(missing_ok=True)
