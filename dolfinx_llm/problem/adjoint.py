"""Sensitivities of what has been solved."""

from __future__ import annotations

from collections.abc import Sequence

import ufl
from dolfinx import fem

from dolfinx_llm.base.parallel import collective
from dolfinx_llm.problem.bulk import LinearBulk
from dolfinx_llm.problem.form_arguments import given_forms, in_order
from dolfinx_llm.problem.methods import ContactMethod


class Differentiable:
    """A problem whose last solve can be differentiated."""

    bulk: LinearBulk
    method: ContactMethod

    def adjoint(self, dJ: ufl.Form | Sequence[ufl.Form]) -> fem.Function | list[fem.Function]:
        """Solve the transposed system of the last ``solve``, with its state of contact, for the
        sensitivities of a functional J(u): with p that is returned, dJ/dm is the derivative of
        L(p) - a(u, p) by what m changes there, u held. Collective.

        With friction it is that of one load step from rest, taken in one part, or of several in
        which nothing has slipped or opened before: what is left of earlier steps depends on m, too.

        Args:
            dJ: linear form, ``ufl.derivative(J, u, v)`` with v a test function of the space; a
                sequence of them for several meshes.

        Returns:
            The adjoint displacement p, zero where displacements are prescribed.

        Raises:
            ContactInputError: another form.
            ContactError: nothing has been solved; contact alone holds a body; the form a is not
                symmetric; the state depends on load steps, or parts of the last one, before.
        """
        with collective(self.bulk.comm):
            forms = in_order(self.bulk.forms, self.bulk.spaces, given_forms(1, dJ))
        found = self.bulk.functions(self.method.adjoint(self.bulk.gradient(forms)))
        return found if self.bulk.several else found[0]
