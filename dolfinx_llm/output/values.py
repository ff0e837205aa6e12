"""Derived quantities: von Mises stress, values at points and in cells."""

from typing import Any

import dolfinx.fem
import dolfinx.io
import dolfinx.mesh
import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.geometry.spaces import check_space, displacement_block, is_function, is_mixed
from dolfinx_llm.interface.forces import InterfaceForces

EXPRESSION = "give a scalar UFL expression without test and trial functions"


def von_mises(sigma: Expr) -> Expr:
    """UFL expression of the von Mises stress, sqrt(3/2 s:s) of the deviator s [force / area].

    Args:
        sigma: (3, 3) UFL expression of the stress [force / area].

    Raises:
        ContactInputError: another type or shape.
    """
    accepted = "give a UFL expression of shape (3, 3), in plane strain with the stress across"
    if checks.instance("sigma", sigma, Expr, accepted).ufl_shape != (3, 3):
        checks.refuse("sigma", sigma, f"{accepted}, not of shape {sigma.ufl_shape}")
    s = sigma - ufl.tr(sigma) / 3 * ufl.Identity(3)
    return ufl.sqrt(1.5 * ufl.inner(s, s))


def at_quadrature_points(expression: Expr, mesh: dolfinx.mesh.Mesh, degree: int = 2) -> Array:
    """Values of a scalar UFL expression at the quadrature points of this rank's cells.

    Args:
        expression: scalar UFL expression.
        mesh: the mesh that it lives on.
        degree: of the quadrature.

    Returns:
        (n_cells, n_points).

    Raises:
        ContactInputError: another type, an expression that is no scalar or lives elsewhere.
    """
    check_expression(expression, mesh, degree)
    points = compat.quadrature_points(mesh, degree)
    try:
        return compat.evaluate(expression, points, mesh)
    except Exception as error:
        text = " ".join(str(error).split())[:300]
        raise ContactInputError(f"expression: cannot be evaluated on the mesh: {text}") from error


def check_problem(problem: Any) -> None:
    """Require something that solves as the problems do."""
    if {"solve", "reset", "u"} - set(dir(type(problem))):
        checks.refuse("problem", problem, "give a ContactProblem")


def check_expression(expression: Any, mesh: Any, degree: Any) -> None:
    """Require a scalar expression on a mesh, and a degree of quadrature."""
    checks.instance("mesh", mesh, dolfinx.mesh.Mesh, "give a dolfinx mesh")
    accepted = "give an integer from 0 to 30"
    if checks.integer("degree", degree, accepted, low=0) > 30:
        checks.refuse("degree", degree, accepted)
    if checks.instance("expression", expression, Expr, EXPRESSION).ufl_shape:
        shape = expression.ufl_shape
        take = f"not of shape {shape}: a component, as s[0, 0], or llm.post.von_mises(s)"
        checks.refuse("expression", expression, f"{EXPRESSION}, {take}")
    if ufl.algorithms.extract_arguments(expression):
        checks.refuse("expression", expression, EXPRESSION)
    for function in ufl.algorithms.extract_coefficients(expression):
        space = getattr(function, "function_space", None)
        if getattr(space, "mesh", None) is not mesh:
            checks.refuse("expression", expression, "its Functions must live on the same mesh")


def check_fields(fields: Any, mesh: Any) -> None:
    """Require names of scalar expressions on a mesh."""
    accepted = 'give a dict of names and scalar UFL expressions, e.g. {"pressure": p}, or None'
    for name, expression in checks.instance("cell_fields", fields, dict, accepted).items():
        checks.instance("cell_fields: name", name, str, accepted)
        check_expression(expression, mesh, 2)


def check_result(result: Any) -> None:
    """Require a result of an interface."""
    accepted = "give a result of a solve, e.g. problem.results[0]"
    checks.instance("result", result, InterfaceForces, accepted)


def check_displacement(u: Any) -> Any:
    """Require a displacement; the communicator of its mesh. Collective."""
    accepted = "give the displacement, a dolfinx Function, or what solve() returned"
    V = checks.instance("u", u, dolfinx.fem.Function, accepted).function_space
    check_space(V, highest=2, scalar=True)
    return u.function_space.mesh.comm


def of_scalar(parts: dict[str, Any]) -> dict[str, Any]:
    """Fields of an interface's parts, as of ``interface_fields``, where a scalar field is solved
    for: u, and what flows from side 0 to side 1, per area and in all."""
    names = {"displacement": "u", "pressure": "flux", "normal_force": "flow", "area": "area"}
    return {
        part: (x, cells, {new: np.ravel(own[old]) for old, new in names.items() if old in own})
        for part, (x, cells, own) in parts.items()
    }


def displacements(u: Any) -> list[dolfinx.fem.Function]:
    """The displacement of every mesh of a solution, or of a list of them; of a mixed space a
    Function of its block. What is no Function is left as it is."""
    found = []
    for function in u if isinstance(u, (list, tuple)) else [u]:
        if is_function(function) and is_mixed(function.function_space):
            V, dofs = displacement_block(function.function_space)
            block = dolfinx.fem.Function(V, name=function.name)
            block.x.array[:] = function.x.array[dofs]
            function = block
        found.append(function)
    return found


def cell_maximum(
    expression: Expr, mesh: dolfinx.mesh.Mesh, degree: int = 2
) -> dolfinx.fem.Function:
    """Largest value of a scalar UFL expression per cell, as a piecewise constant Function.

    Args:
        expression: scalar UFL expression.
        mesh: the mesh that it lives on.
        degree: of the quadrature, at whose points the expression is evaluated.

    Raises:
        ContactInputError: as of ``at_quadrature_points``; on all ranks.
    """
    checks.instance("mesh", mesh, dolfinx.mesh.Mesh, "give a dolfinx mesh")
    with collective(mesh.comm):
        check_expression(expression, mesh, degree)
    V = compat.function_space(mesh, "DG", 0)
    function = dolfinx.fem.Function(V)
    values = at_quadrature_points(expression, mesh, degree)
    function.x.array[compat.cell_dofs(V)[: len(values), 0]] = values.max(axis=1)
    function.x.scatter_forward()
    return function
