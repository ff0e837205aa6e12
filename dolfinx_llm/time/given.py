"""What a stepper is given: densities and the length of a step, checked."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.problem.bulk import Fingerprint

DENSITY = "give a positive number, a UFL expression or a list of them, one per mesh"
LENGTHS = 1e-100, 1e100  # of a step, whose squares are numbers


def step_length(dt: Any) -> float:
    """A length of a step."""
    low, high = LENGTHS
    accepted = f"give a positive number, of {low:g} to {high:g}"
    if checks.number("dt", dt, accepted, low=low) > high:
        checks.refuse("dt", dt, accepted)
    return float(dt)


def given_densities(rho: Any, spaces: Sequence[Any]) -> list[Any]:
    """One density per mesh, UFL."""
    given = list(rho) if isinstance(rho, (list, tuple)) else [rho] * len(spaces)
    if len(given) != len(spaces):
        checks.refuse("rho", rho, DENSITY)
    return [_density(density, V.mesh) for density, V in zip(given, spaces, strict=True)]


def _density(density: Any, mesh: Any) -> Any:
    if not isinstance(density, ufl.core.expr.Expr):
        return fem.Constant(mesh, checks.number("rho", density, DENSITY, above=0.0))
    if density.ufl_shape:
        checks.refuse("rho", density, DENSITY)
    if isinstance(density, fem.Constant):
        checks.number("rho", density.value, DENSITY, above=0.0)
    form = density * ufl.dx(domain=mesh)
    if form.arguments():
        checks.refuse("rho", density, "it has a test or trial function; " + DENSITY)
    for function in form.coefficients():
        if isinstance(function, fem.Function) and function.function_space.mesh is not mesh:
            raise ContactInputError(
                f"rho: the Function {function.name} is of another mesh than the body: interpolate "
                "it, or give a list, one density per mesh in the order of the forms"
            )
    return density


class KnownMass:
    """Requires that what the mass was assembled of stays as it was: the forms of inertia hold
    values of now, and the mass those of the start.

    Args:
        forms: of the mass, one per mesh.
        spaces: of the displacements.
        diagonals: (n_local,) of the mass of each mesh.

    Raises:
        ContactInputError: masses that are NaN, negative, or all 0 in a mesh.
    """

    def __init__(
        self, forms: Sequence[ufl.Form], spaces: Sequence[Any], diagonals: Sequence[Array]
    ) -> None:
        for mass in diagonals:
            check_mass(spaces[0].mesh.comm, mass)
        self._fingerprint, self._changed = Fingerprint(forms, spaces), False
        self._fingerprint.changes(())

    def require(self) -> None:
        """Collective.

        Raises:
            ContactInputError: a density or a mesh has changed, now or before.
        """
        self._changed |= bool(self._fingerprint.changes(()))
        if self._changed:
            raise ContactInputError(
                "rho, or positions of a mesh, have changed since the TimeStepper was made, which "
                "steps in time do not follow: make another one, with u, v and t of this one"
            )


def check_mass(comm: MPI.Comm, mass: Array) -> None:
    """Require masses (n_local,) of a mesh that are numbers, not negative, and not all 0;
    collective.

    Raises:
        ContactInputError: they are not.
    """
    wrong = comm.allreduce(int((~np.isfinite(mass) | (mass < 0.0)).sum()))
    total, least = comm.allreduce(float(mass.sum())), float(mass.min(initial=np.inf))
    least = comm.allreduce(least, op=MPI.MIN)
    if wrong or not total > 0.0:
        what = f"{wrong} of the masses are negative or NaN, the least {least:.3g}"
        raise ContactInputError(
            f"rho: {what if wrong else 'all masses are 0'} in a mesh: give a density that is "
            "positive in every body"
        )
