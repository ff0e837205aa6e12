"""The UFL forms that ``ContactProblem`` is given, and their function spaces: checked."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.measure import integral_type_to_measure_name

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import agree

FORMS = {
    2: ("a", "must be bilinear", "give a bilinear UFL form, or a list of them, one per mesh"),
    1: (
        "L",
        "must be linear",
        "give a linear UFL form, or a list of them; without loads "
        "ufl.inner(fem.Constant(mesh, (0.0, ...)), v) * ufl.dx",
    ),
}


def listed(value: Any) -> Sequence[Any]:
    """A value that may be one or several."""
    return value if isinstance(value, (list, tuple)) else [value]


def given_forms(count: int, value: Any, entity_maps: Any) -> list[ufl.Form]:
    """UFL forms with a number of arguments, of one mesh each unless there are entity maps."""
    name, kind, accepted = FORMS[count]
    forms = list(listed(value))
    if not forms:
        checks.refuse(name, value, accepted)
    for form in forms:
        checks.instance(name, form, ufl.Form, accepted)
        arguments = form.arguments()
        if len(arguments) != count:
            hint = ", or is zero as a whole" if not arguments else ""
            if len(arguments) > 2:
                hint = ": of a ufl.MixedFunctionSpace? Take a function space of a mixed element"
            raise ContactInputError(
                f"the form {name} {kind}, has {len(arguments)} argument(s){hint}: {accepted}"
            )
        meshes = [V.mesh for V in map(_space_of, arguments) if V is not None]
        meshes += [
            c.function_space.mesh for c in form.coefficients() if isinstance(c, fem.Function)
        ]
        if len(meshes) < count:
            checks.refuse(name, form, "its arguments must be of dolfinx function spaces")
        check_parts(name, form)
        if entity_maps is not None:
            continue
        domains = {domain.ufl_id() for domain in form.ufl_domains()}
        if any(mesh is not meshes[0] for mesh in meshes) or len(domains) > 1:
            raise ContactInputError(
                f"the form {name} lives on several meshes: give one form per mesh, whose arguments "
                "and Functions are of that mesh; or entity_maps, as of dolfinx.fem.form (0.8 and "
                "newer), where one is a submesh of the other"
            )
    return forms


def check_parts(name: str, form: ufl.Form) -> None:
    """Require tags for integrals over numbered parts: without, dolfinx takes them for zero."""
    tagged = [i for i in form.integrals() if i.subdomain_data() is not None]
    kinds = {(i.ufl_domain(), i.integral_type()) for i in tagged}
    for i in form.integrals():
        part, kind = i.subdomain_id(), i.integral_type()
        if (i.ufl_domain(), kind) not in kinds and not isinstance(part, str):
            measure = integral_type_to_measure_name[kind]
            raise ContactInputError(
                f"the form {name} has an integral over {measure}({part}), and no tags that tell "
                f"where that is: give ufl.{measure}(subdomain_data=tags)"
            )


def check_unknowns(forms: Sequence[ufl.Form], functions: Sequence[fem.Function]) -> None:
    """Require that each form is written in the Function that is its unknown."""
    for form, u in zip(forms, functions, strict=True):
        if not any(c is u for c in form.coefficients()):
            names = sorted(c.name for c in form.coefficients() if isinstance(c, fem.Function))
            raise ContactInputError(
                f"a form F does not depend on its u, the Function {u.name}; it has {names}: give "
                "the very Function that F is written in"
            )


def agree_on_constants(comm: MPI.Comm, forms: Sequence[ufl.Form]) -> None:
    """Require that Constants of the forms have the same values on all ranks; collective."""
    found = [np.ravel(c.value).tolist() for form in forms for c in form.constants()]
    agree(comm, "Constants of the forms (sums over all ranks, where assembled)", found)


def _space_of(argument: Any) -> Any:
    """dolfinx function space of a form's argument, or None."""
    space = argument.ufl_function_space()
    return space if hasattr(space, "dofmap") else None


def form_space(form: ufl.Form) -> Any:
    """Function space of a bilinear form."""
    test, trial = (_space_of(argument) for argument in form.arguments())
    if not compat.same_space(test, trial):
        raise ContactInputError(
            "the form a has test and trial functions of two spaces: take both of one space"
        )
    return test


def same_space(V: Any, W: Any) -> bool:
    """Whether two function spaces number the same values in the same way."""
    if V is W:
        return True
    if V.mesh is not W.mesh or V.ufl_element() != W.ufl_element():
        return False
    dofs = compat.cell_dofs(V), compat.cell_dofs(W)
    return dofs[0].shape == dofs[1].shape and bool((dofs[0] == dofs[1]).all())


def check_meshes(spaces: Sequence[Any]) -> None:
    """One form per mesh, of one communicator and dimension."""
    if len({id(V.mesh) for V in spaces}) < len(spaces):
        raise ContactInputError(
            "two of the forms a live on one mesh: give one form per mesh, the sum of what lives on "
            "it"
        )
    for V in spaces:
        check_positions(V.mesh)
    first = spaces[0].mesh
    for V in spaces[1:]:
        if MPI.Comm.Compare(first.comm, V.mesh.comm) not in (MPI.IDENT, MPI.CONGRUENT):
            raise ContactInputError("the meshes of the forms a are of different communicators")
        if V.mesh.geometry.dim != first.geometry.dim:
            dims = [V.mesh.geometry.dim for V in spaces]
            raise ContactInputError(f"the meshes of the forms a lie in {dims} dimensions: mix none")


def check_positions(mesh: Any) -> None:
    """Require nodes of this rank that are at finite positions."""
    bad = int((~np.isfinite(mesh.geometry.x)).any(axis=1).sum())
    if bad:
        raise ContactInputError(
            f"positions of {bad} node(s) of a mesh are NaN or infinite: check how it was made and "
            "moved"
        )


def in_order(a: list[ufl.Form], spaces: Sequence[Any], L: list[ufl.Form]) -> list[ufl.Form]:
    """The linear forms in the order of the bilinear ones, matched by their spaces."""
    if len(a) != len(L):
        raise ContactInputError(
            f"{len(a)} bilinear forms, {len(L)} linear ones: give one of each per mesh"
        )
    ordered = []
    for V in spaces:
        found = [form for form in L if same_space(_space_of(form.arguments()[0]), V)]
        if len(found) != 1:
            raise ContactInputError(
                f"{len(found)} of the forms L have a test function of the space of a form a: give "
                "one per form a, with a test function of the same function space"
            )
        ordered += found
    return ordered
