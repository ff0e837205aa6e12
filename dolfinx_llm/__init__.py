"""Mortar-free contact for FEniCSx by localised Lagrange multipliers."""

# First, since it says what to install where dolfinx is missing.
from dolfinx_llm import compat  # noqa: F401  # isort: skip

from dolfinx_llm import classical, plot, post
from dolfinx_llm._parallel import ContactError, ContactInputError
from dolfinx_llm.design import design_weights
from dolfinx_llm.frame import Frame
from dolfinx_llm.interface import Interface
from dolfinx_llm.laws import Coulomb, Frictionless, Tied
from dolfinx_llm.loads import free_surface_load
from dolfinx_llm.obstacles import RigidCylinder, RigidPlane, RigidSphere, RigidSurface
from dolfinx_llm.positions import design_positions
from dolfinx_llm.problem import ContactProblem

__version__ = "0.1.0"

__all__ = [
    "Coulomb",
    "ContactError",
    "ContactInputError",
    "ContactProblem",
    "Frame",
    "Frictionless",
    "Interface",
    "RigidCylinder",
    "RigidPlane",
    "RigidSphere",
    "RigidSurface",
    "Tied",
    "classical",
    "design_positions",
    "design_weights",
    "free_surface_load",
    "plot",
    "post",
]
