"""Nonlinear forces of a step as their mean on the way, whose work is the change of energy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_llm.base import compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.problem.bulk import fill

ON_THE_WAY = 4  # points on the way at which forces are evaluated


class MeanForces:
    """Twice the mean of residual forms F on the straight way of a step, less F at both its ends.

    With it the trapezoidal rule has the mean, whose work is the change of F's energy, if it has
    one, but for quadrature on the way; loads that do not depend on u drop out. Nothing where F is
    linear in u.

    Args:
        F: residual forms, one per mesh.
        u: displacements at the end of a step, in which they are written.
        entity_maps: of dolfinx, per form, or None.

    Attributes:
        forms: to be added to F.
    """

    def __init__(
        self, F: Sequence[ufl.Form], u: Sequence[fem.Function], entity_maps: Sequence[Any]
    ) -> None:
        self._before = [fem.Function(w.function_space, name="u0") for w in u]
        self._on = [fem.Constant(w.function_space.mesh, 1.0) for w in u]
        parts = zip(F, u, self._before, self._on, strict=True)
        self.forms = [on * _beyond_the_mean(form, w, w0) for form, w, w0, on in parts]
        self._compiled = compat.forms("F", self.forms, entity_maps)

    def begin(self, u: Array, counts: Sequence[int], part: float) -> None:
        """Start a step at this rank's u (n_local,), so many dofs of each mesh, in which this part
        is felt; 0: forces are those of its end. Collective."""
        fill(self._before, u, counts)
        for on in self._on:
            on.value = part

    def values(self) -> Array:
        """(n_local,) of this rank, for the displacements as they are now; collective."""
        parts = zip(self._compiled, self._before, strict=True)
        found = [compat.assemble_force((form,), (1.0,), w.function_space) for form, w in parts]
        return np.concatenate(found)


def _beyond_the_mean(F: ufl.Form, u: fem.Function, u0: fem.Function) -> ufl.Form:
    points, weights = np.polynomial.legendre.leggauss(ON_THE_WAY)
    way = [u0 + float(0.5 + 0.5 * s) * (u - u0) for s in points]
    means = [float(w) * ufl.replace(F, {u: at}) for w, at in zip(weights, way, strict=True)]
    return sum(means, -F - ufl.replace(F, {u: u0}))
