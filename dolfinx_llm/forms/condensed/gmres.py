"""A Krylov method, preconditioned from the right, for matrices that are known by their products."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.forms.options import NoOption, words_of

Product = Callable[[Array], Array]  # of this rank's part of a vector; collective
RESTART = 75  # vectors that GMRES keeps


@dataclass(frozen=True, eq=False)
class Shell:
    """A matrix or a preconditioner, for PETSc."""

    times: Product

    def mult(self, _: Any, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """The product with a vector."""
        y.array_w[:] = self.times(x.array_r)

    apply = mult


def solve_right(
    comm: Any,
    matrix: Product,
    preconditioner: Product,
    b: Array,
    method: str,
    tolerances: tuple[float, float, float, int],
) -> tuple[Array, int, int]:
    """This rank's part of x with A x = b, the iterations it took, and PETSc's reason of the end.

    Args:
        comm: of PETSc.
        matrix, preconditioner: A, and what is near its inverse.
        b: this rank's part.
        method: "gmres", or another that PETSc knows.
        tolerances: relative, absolute, of divergence, and most iterations; of the residual.

    Raises:
        NoOption: a method that cannot be preconditioned from the right.
    """
    n = len(b), PETSc.DETERMINE
    A = PETSc.Mat().createPython((n, n), Shell(matrix), comm=comm)
    A.setUp()
    ksp = PETSc.KSP().create(comm)
    ksp.setOperators(A)
    ksp.setType(method)
    ksp.setPCSide(PETSc.PC.Side.RIGHT)
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.setTolerances(*tolerances)
    if method.endswith("gmres"):
        ksp.setGMRESRestart(RESTART)
    ksp.getPC().setType("python")
    ksp.getPC().setPythonContext(Shell(preconditioner))
    x, rhs = A.createVecs()
    rhs.array_w[:] = b
    try:
        ksp.setUp()
    except PETSc.Error as error:
        raise NoOption(
            f"petsc_options: ksp_type={method!r} does not suit this system, which is not symmetric "
            f"and preconditioned from the right ({words_of(error)}): give 'gmres', 'fgmres' or "
            "'bcgs', or leave it out"
        ) from None
    ksp.solve(rhs, x)
    found = x.array_r.copy(), ksp.getIterationNumber(), ksp.getConvergedReason()
    for item in (ksp, A, x, rhs):
        item.destroy()
    return found
