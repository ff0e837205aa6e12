"""Where files go, errors of writing them, and surfaces with fields at their nodes as XDMF: text
alone, a time series, without a library."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from dolfinx_llm.base import checks
from dolfinx_llm.base.errors import ContactInputError

KINDS = {1: "Polyvertex", 2: "Polyline", 3: "Triangle", 4: "Quadrilateral"}  # by nodes of a cell
HEAD = """<?xml version="1.0"?>
<Xdmf Version="3.0">
<Domain>
<Grid Name="steps" GridType="Collection" CollectionType="Temporal">
"""
TAIL = "</Grid>\n</Domain>\n</Xdmf>\n"


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


def write_step(
    path: Path,
    time: float,
    x: np.ndarray,
    cells: np.ndarray,
    fields: dict[str, np.ndarray],
    append: bool,
) -> None:
    """Write a step of a surface: nodes x (n, gdim), cells (m, k), and fields (n,) or (n, gdim) at
    the nodes; append it to those of a file that this function began, or begin one."""
    kind = f'TopologyType="{KINDS[cells.shape[1]]}" NumberOfElements="{len(cells)}"'
    lines = [
        f'<Grid Name="surface" GridType="Uniform">\n<Time Value="{time!r}"/>',
        f'<Topology {kind} NodesPerElement="{cells.shape[1]}">{_item(cells)}</Topology>',
        f'<Geometry GeometryType="XYZ">{_item(_in_space(x))}</Geometry>',
    ]
    for name, values in fields.items():
        kind = "Scalar" if values.ndim == 1 else "Vector"
        item = _item(values if values.ndim == 1 else _in_space(values))
        lines.append(
            f'<Attribute Name="{name}" AttributeType="{kind}" Center="Node">{item}</Attribute>'
        )
    grid = "\n".join([*lines, "</Grid>\n"])
    if not append:
        path.write_text(HEAD + grid + TAIL, encoding="ascii")
        return
    with open(path, "r+b") as file:
        file.seek(-len(TAIL), os.SEEK_END)
        file.write((grid + TAIL).encode("ascii"))


def _in_space(values: np.ndarray) -> np.ndarray:
    """(n, gdim) values as (n, 3)."""
    return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))


def _item(values: np.ndarray) -> str:
    kind = 'NumberType="Float" Precision="8"' if values.dtype.kind == "f" else 'NumberType="Int"'
    rows = "\n".join(" ".join(map(repr, np.atleast_1d(row).tolist())) for row in values)
    size = " ".join(map(str, values.shape))
    return f'<DataItem {kind} Dimensions="{size}" Format="XML">\n{rows}\n</DataItem>'
