"""Mortar-free contact for FEniCSx by localised Lagrange multipliers.

.. include:: method.md
"""

import sys

# First, since it says what to install where dolfinx is missing.
from dolfinx_llm.base import compat  # isort: skip

from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.design.positions import design_positions
from dolfinx_llm.design.weights import design_weights
from dolfinx_llm.finite.pressure import FreeSurfacePressure
from dolfinx_llm.forms.step import LinearStep, StepForm, StepResult
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.interface.choices import Interface, SelfContact
from dolfinx_llm.interface.obstacle import Obstacle
from dolfinx_llm.interface.obstacles import (
    MeanDisplacement,
    RigidCylinder,
    RigidPlane,
    RigidSphere,
    RigidSurface,
)
from dolfinx_llm.laws.conductance import Conductance
from dolfinx_llm.laws.coulomb import Coulomb
from dolfinx_llm.laws.frictionless import Frictionless
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.rows import LawNodes, LawRows
from dolfinx_llm.laws.sliding import Sliding
from dolfinx_llm.laws.tied import Tied
from dolfinx_llm.output import plot, post
from dolfinx_llm.problem import classical
from dolfinx_llm.problem.find import find_interfaces
from dolfinx_llm.problem.loads import free_surface_load
from dolfinx_llm.problem.memory import Evolution
from dolfinx_llm.problem.nonlinear import NonlinearContactProblem
from dolfinx_llm.problem.problem import ContactProblem
from dolfinx_llm.time.stepper import TimeStepper
from dolfinx_llm.time.transfer import transfer

__version__ = "0.2.0"

# Public modules go by their short names, wherever they live: ``import dolfinx_llm.post``.
for _module in (classical, compat, plot, post):
    sys.modules[f"{__name__}.{_module.__name__.rpartition('.')[2]}"] = _module

__all__ = [
    "Conductance",
    "Coulomb",
    "ContactError",
    "ContactInputError",
    "ContactProblem",
    "Evolution",
    "Frame",
    "FreeSurfacePressure",
    "Frictionless",
    "Interface",
    "Law",
    "LawNodes",
    "LawRows",
    "LinearStep",
    "MeanDisplacement",
    "NonlinearContactProblem",
    "Obstacle",
    "RigidCylinder",
    "RigidPlane",
    "RigidSphere",
    "RigidSurface",
    "SelfContact",
    "Sliding",
    "StepForm",
    "StepResult",
    "Tied",
    "TimeStepper",
    "classical",
    "design_positions",
    "design_weights",
    "find_interfaces",
    "free_surface_load",
    "plot",
    "post",
    "transfer",
]
