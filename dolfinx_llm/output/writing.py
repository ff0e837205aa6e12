"""Where files go, and errors of writing them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dolfinx_llm.base import checks
from dolfinx_llm.base.errors import ContactInputError


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Says where something could not be written: by the operating system, HDF5 or Matplotlib."""
    try:
        yield
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, ContactInputError):
            raise
        words = getattr(error, "strerror", None) or " ".join(str(error).split())[:200]
        raise ContactInputError(
            f"{path} cannot be written: {words}. Give a path in a folder that can be made and "
            "written"
        ) from error


def writable_folder(name: str, value: Any) -> Path:
    """A folder, made where it is missing, in which files can be written. Every rank may call it by
    itself: all find the same."""
    folder = checks.path(name, value)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(13, "no permission", str(folder))
    return folder


def writable_file(name: str, value: Any, endings: tuple[str, ...] = ()) -> Path:
    """A file that can be written, in a folder that is made, with one of the endings, if any is
    asked for."""
    path = checks.path(name, value)
    if endings and path.suffix not in endings:
        raise ContactInputError(f"{path}: the file must end on {' or '.join(endings)}")
    writable_folder(name, path.parent)
    with writing(path):
        if path.is_dir() and path.suffix != ".bp":  # which is a folder
            raise IsADirectoryError(21, "is a folder", str(path))
        if path.exists() and not os.access(path, os.W_OK):
            raise PermissionError(13, "no permission", str(path))
    return path
