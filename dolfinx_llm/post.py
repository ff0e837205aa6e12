"""Derived quantities, tables and files."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import ufl

from dolfinx_llm import compat


def von_mises(sigma):
    """UFL expression of the von Mises stress of a (3, 3) stress."""
    s = sigma - ufl.tr(sigma) / 3 * ufl.Identity(3)
    return ufl.sqrt(1.5 * ufl.inner(s, s))


def at_quadrature_points(expression, mesh, degree: int = 2) -> np.ndarray:
    """Values of a scalar UFL expression at the quadrature points of this rank's cells.

    Returns:
        (n_cells, n_points).
    """
    return compat.evaluate(expression, compat.quadrature_points(mesh, degree), mesh)


def write_csv(path, header, rows) -> None:
    """Table as CSV; call it on one rank."""
    with open(Path(path), "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)
