"""Mortar-free contact for FEniCSx by localised Lagrange multipliers.

.. include:: method.md
"""

import importlib.util
import sys
from typing import TYPE_CHECKING

# First, since it says what to install where dolfinx is missing.
from dolfinx_llm.base import compat  # isort: skip

from dolfinx_llm.base.errors import ContactError, ContactInputError
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
from dolfinx_llm.problem.memory import Evolution
from dolfinx_llm.problem.problem import ContactProblem

__version__ = "0.2.0"
# Public modules go by their short names, wherever they live: ``import dolfinx_llm.post``.
sys.modules[f"{__name__}.compat"] = compat

# What many scripts do without, a third of the time of all imports, is imported at its first use.
if TYPE_CHECKING:
    from dolfinx_llm.design.positions import design_positions
    from dolfinx_llm.design.weights import design_weights
    from dolfinx_llm.finite.pressure import FreeSurfacePressure
    from dolfinx_llm.output import plot, post
    from dolfinx_llm.problem import classical
    from dolfinx_llm.problem.find import find_interfaces
    from dolfinx_llm.problem.loads import free_surface_load
    from dolfinx_llm.problem.nonlinear import NonlinearContactProblem
    from dolfinx_llm.time.stepper import TimeStepper
    from dolfinx_llm.time.transfer import transfer
else:

    def _later(place):
        spec, short = importlib.util.find_spec(f"{__name__}.{place}"), place.split(".")[1]
        spec.loader = importlib.util.LazyLoader(spec.loader)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        sys.modules[spec.name] = sys.modules[f"{__name__}.{short}"] = module
        setattr(sys.modules[spec.name.rpartition(".")[0]], short, module)
        return module

    classical, plot, post = map(_later, ("problem.classical", "output.plot", "output.post"))
    _PLACES = {
        "FreeSurfacePressure": "finite.pressure",
        "NonlinearContactProblem": "problem.nonlinear",
        "TimeStepper": "time.stepper",
        "design_positions": "design.positions",
        "design_weights": "design.weights",
        "find_interfaces": "problem.find",
        "free_surface_load": "problem.loads",
        "transfer": "time.transfer",
    }

    def __getattr__(name):
        if name not in _PLACES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        found = getattr(importlib.import_module(f"{__name__}.{_PLACES[name]}"), name)
        globals()[name] = found
        return found

    def __dir__():
        return sorted({*globals(), *_PLACES})


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
