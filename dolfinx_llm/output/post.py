"""Derived quantities, tables and files: what ``llm.post`` offers."""

from dolfinx_llm.output.files import LoadSteps, interface_fields, write_bodies, write_interface
from dolfinx_llm.output.values import at_quadrature_points, cell_maximum, von_mises
from dolfinx_llm.output.writing import write_csv

__all__ = [
    "LoadSteps",
    "at_quadrature_points",
    "cell_maximum",
    "interface_fields",
    "von_mises",
    "write_bodies",
    "write_csv",
    "write_interface",
]
