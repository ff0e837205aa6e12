"""What ``ContactProblem`` is given: checked on all ranks together before anything is made of it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import agree, collective
from dolfinx_llm.finite.pressure import FreeSurfacePressure
from dolfinx_llm.forms.choice import SOLVERS
from dolfinx_llm.forms.options import check_values
from dolfinx_llm.forms.step import StepForm
from dolfinx_llm.geometry.spaces import is_scalar
from dolfinx_llm.geometry.thickness import check_all_have
from dolfinx_llm.interface.choices import Interface, SelfContact
from dolfinx_llm.problem.blocks import Blocks
from dolfinx_llm.problem.form_arguments import (
    check_meshes,
    form_space,
    given_forms,
    in_order,
    listed,
    same_space,
)

BCS = "give a list of Dirichlet conditions (fem.dirichletbc)"
PRESSURES = "give a list of FreeSurfacePressure"
LOADS = "give a list of dolfinx Functions of nodal forces"
INTERFACES = "give at least one Interface, or a list of them"


@dataclass(frozen=True)
class Arguments:
    """Arguments of a problem that fit each other."""

    several: bool  # forms came as sequences
    a: list[ufl.Form]  # bilinear, one per mesh
    L: list[ufl.Form]  # linear, in the order of a
    blocks: list[Blocks]  # function space of each, and that of its displacement
    bcs: Sequence[Any]  # Dirichlet conditions; the user's own list, which may change
    interfaces: list[Interface]
    nodal_loads: list[fem.Function]  # the user's own list, too
    entity_maps: list[Any]  # of dolfinx, per form a, or None


def problem_arguments(
    a: Any,
    L: Any,
    bcs: Any,
    interfaces: Any,
    nodal_loads: Any,
    solver: Any,
    petsc_options_prefix: Any,
    petsc_options: Any,
    entity_maps: Any,
) -> Arguments:
    """Check the arguments of ``ContactProblem``; collective: ``ContactInputError`` on all ranks."""
    comm = communicator(a, L, bcs, nodal_loads)
    with collective(comm):
        forms = given_forms(2, a, entity_maps)
        spaces = [form_space(form) for form in forms]
        check_meshes(spaces)
    blocks = [Blocks(V) for V in spaces]
    if len({is_scalar(b.V) for b in blocks}) > 1:
        raise ContactInputError(
            "one form a is of displacements, another of a scalar field: make a problem of each"
        )
    with collective(comm):
        loads = in_order(forms, spaces, given_forms(1, L, entity_maps))
        given = Arguments(
            isinstance(a, (list, tuple)),
            forms,
            loads,
            blocks,
            kept_list(bcs, conditions(bcs, spaces)),
            interface_list(interfaces, spaces),
            kept_list(nodal_loads, nodal_list(nodal_loads, blocks)),
            compat.entity_maps_of(entity_maps, len(forms)),
        )
        for interface in given.interfaces:
            if isinstance(interface, SelfContact):
                raise ContactInputError(
                    f"interface {interface.name}: a surface meets itself at finite deformation "
                    "alone, in a NonlinearContactProblem"
                )
        own = isinstance(solver, StepForm)
        if not own:
            checks.one_of("solver", solver, SOLVERS)
        check_petsc_options(petsc_options, petsc_options_prefix)
        if own and petsc_options:
            raise ContactInputError(
                "petsc_options are of the package's own forms: hand those of a form of your own to "
                "its constructor"
            )
    named = solver.name if own else solver
    agree_on(comm, given, forms, (named, petsc_options_prefix, petsc_options))
    return given


def agree_on(
    comm: MPI.Comm, given: Any, forms: Sequence[ufl.Form], solver: tuple[Any, ...]
) -> None:
    """Require that all ranks have as many conditions, loads and forms, and the same interfaces,
    solver and PETSc options."""
    counts = len(given.bcs), len(given.nodal_loads), len(forms)
    agree(comm, "the numbers of Dirichlet conditions, nodal loads and forms", counts)
    agree(comm, "the interfaces", [_told(interface) for interface in given.interfaces])
    agree(comm, "solver and PETSc options", solver)


def step_arguments(
    comm: MPI.Comm, increments: Any, interfaces: Sequence[Interface], spaces: Sequence[Any]
) -> int:
    """Check the increments that ``ContactProblem.solve`` is given, and where obstacles are now;
    collective."""
    with collective(comm):
        parts = checks.integer("increments", increments, "give an integer of at least 1", low=1)
        obstacles = [i.obstacle for i in interfaces if i.obstacle is not None]
        gdim = spaces[0].mesh.geometry.dim
        poses = [(o.pose(gdim), checks.shown(getattr(o, "mean", None))) for o in obstacles]
    agree(comm, "increments", parts)
    agree(comm, "motions of and forces on obstacles", poses)
    return parts


def check_petsc_options(options: Any, prefix: Any = "") -> None:
    """Require PETSc options as None or a dict of names, without prefix and hyphen, and values; and
    a prefix."""
    if not (isinstance(prefix, str) and re.fullmatch(r"(\w[\w.]*)?", prefix)):
        checks.refuse("petsc_options_prefix", prefix, 'give a word such as "llm_", without hyphen')
    if options is None:
        return
    accepted = 'give a dict of names and values, e.g. {"ksp_type": "cg"}, or None'
    checks.instance("petsc_options", options, dict, accepted)
    for key, value in options.items():
        if not (isinstance(key, str) and re.fullmatch(r"\w[\w.]*", key)):
            checks.refuse("petsc_options: name", key, 'give a name such as "ksp_type", no hyphen')
        plain = value is None or isinstance(value, (str, bool, np.bool_))
        if not plain:
            checks.number(f'petsc_options: "{key}"', value, "give a text, a finite number, or None")
    check_values(options)


def communicator(*given: Any) -> MPI.Comm:
    """Of the first form, condition or load that has one."""
    found = [_mesh_of(item) for value in given for item in listed(value)]
    mesh = next((mesh for mesh in found if mesh is not None), None)
    return MPI.COMM_SELF if mesh is None else mesh.comm


def _mesh_of(item: Any) -> Any:
    """Mesh of a form's arguments, a condition or a Function; None if there is none."""
    space = getattr(item, "function_space", None)
    if isinstance(item, ufl.Form):
        parts = (*item.arguments(), *item.coefficients())
        space = parts[0].ufl_function_space() if parts else None
    return getattr(space, "mesh", None)


def _is_condition(bc: Any) -> bool:
    """Whether this is a Dirichlet condition; their class bears other names in other versions."""
    return hasattr(bc, "function_space") and hasattr(bc, "g") and not isinstance(bc, type)


def conditions(bcs: Any, spaces: Sequence[Any]) -> list[Any]:
    """Dirichlet conditions of the function spaces as a list."""
    found = [bcs] if _is_condition(bcs) else checks.items("bcs", bcs, BCS)
    for bc in found:
        if not _is_condition(bc):
            checks.refuse("bcs: item", bc, BCS)
        values = getattr(bc.g, "x", None)  # of a Function; a Constant has a value
        if np.iscomplexobj(getattr(bc.g, "value", bc.g) if values is None else values.array):
            raise ContactInputError("a Dirichlet condition has complex values: give real ones")
        if not any(compat.in_space(bc, V) for V in spaces):
            raise ContactInputError("a Dirichlet condition belongs to none of the forms' spaces")
    return found


def kept_list(given: Any, found: list[Any]) -> list[Any]:
    """The user's own list where it is one, which may change; else what was found in it."""
    return given if isinstance(given, list) else found


def by_mesh(comm: MPI.Comm, bcs: Any, spaces: Sequence[Any]) -> list[list[Any]]:
    """The conditions of each function space; collective."""
    with collective(comm):
        found = conditions(bcs, spaces)
    return [[bc for bc in found if compat.in_space(bc, V)] for V in spaces]


def nodal_by_mesh(comm: MPI.Comm, loads: Any, blocks: Sequence[Blocks]) -> list[list[fem.Function]]:
    """The nodal loads of each mesh; collective."""
    with collective(comm):
        found = nodal_list(loads, blocks)
    return [[load for load in found if load.function_space.mesh is b.W.mesh] for b in blocks]


def nodal_list(loads: Any, blocks: Sequence[Blocks]) -> list[fem.Function]:
    """The nodal loads of the forms' spaces, or of their displacements', as a list."""
    spaces = [V for b in blocks for V in (b.W, b.V)]
    one = isinstance(loads, fem.Function)
    found = [loads] if one else checks.items("nodal_loads", loads, LOADS)
    for load in found:
        checks.instance("nodal_loads: item", load, fem.Function, LOADS)
        V = load.function_space
        if not any(V.mesh is W.mesh for W in spaces):
            raise ContactInputError("a nodal load lives on none of the forms' meshes")
        if np.iscomplexobj(load.x.array):
            raise ContactInputError(f"nodal load {load.name}: complex values: give real ones")
        if not any(same_space(V, W) for W in spaces):
            raise ContactInputError(
                f"nodal load {load.name}: must be a Function of the space of the form"
            )
    return found


def interface_list(interfaces: Any, spaces: Sequence[Any]) -> list[Interface]:
    one = isinstance(interfaces, Interface)
    found = [interfaces] if one else checks.items("interfaces", interfaces, INTERFACES)
    if not found:
        raise ContactInputError(INTERFACES)
    for interface in found:
        checks.instance("interfaces: item", interface, Interface, INTERFACES)
        for tags, _ in interface.tagged_sides():
            check_tags_belong(tags, spaces)
    check_all_have(_thick(found))
    return found


def pressure_list(
    loads: Any, spaces: Sequence[Any], interfaces: Sequence[Interface]
) -> list[FreeSurfacePressure]:
    """Follower pressures on surfaces of the meshes, beside interfaces."""
    one = isinstance(loads, FreeSurfacePressure)
    found = [loads] if one else checks.items("loads", loads, PRESSURES)
    for load in found:
        checks.instance("loads: item", load, FreeSurfacePressure, "give FreeSurfacePressure")
        for tags, _ in load.tagged():
            check_tags_belong(tags, spaces)
    named = [(f"loads[{k}], tag {p.tag},", p.thickness) for k, p in enumerate(found)]
    check_all_have([*_thick(interfaces), *named])
    return found


def check_tags_belong(tags: Any, spaces: Sequence[Any]) -> None:
    """Require facet tags of one of the meshes."""
    if not any(compat.tags_belong_to(tags, V.mesh) for V in spaces):
        raise ContactInputError(
            "the facet tags belong to none of the meshes of the forms. For bodies on two meshes "
            "give sides=((tags_0, tag_0), (tags_1, tag_1))"
        )


def _thick(interfaces: Sequence[Interface]) -> list[tuple[str, Any]]:
    """Names and thicknesses."""
    return [(f"interfaces[{k}], {i.name},", i.thickness) for k, i in enumerate(interfaces)]


def _told(interface: Interface) -> tuple[Any, ...]:
    """An interface's choices as plain data, to compare them between ranks."""
    frame, obstacle = interface.frame, interface.obstacle
    nodes = () if frame is None else (frame.x.tolist(), frame.cells.tolist())
    law, rigid = checks.shown(interface.law), "" if obstacle is None else repr(obstacle)
    given = str(interface.design), rigid, str(interface.shift), checks.shown(interface.thickness)
    return interface.name, law, *given, *nodes
