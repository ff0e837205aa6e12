"""The one module that knows that dolfinx has versions (0.5.2 to 0.11), told apart by feature."""

from __future__ import annotations

import importlib.util
import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

try:
    import basix
    import dolfinx
    import dolfinx.common
    import dolfinx.fem.petsc
    import dolfinx.geometry
    import dolfinx.io
    import numpy as np
    import ufl
    from petsc4py import PETSc
    from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
    from ufl.algorithms.apply_derivatives import apply_derivatives
    from ufl.algorithms.check_arities import ArityMismatch, check_form_arity
    from ufl.algorithms.remove_complex_nodes import remove_complex_nodes
except ImportError as error:
    raise ImportError(
        "dolfinx_llm needs dolfinx with petsc4py and mpi4py. On Debian or Ubuntu: "
        "apt install python3-dolfinx, and a Python that sees it "
        "(/usr/bin/python3 -m venv --system-site-packages .venv; `make setup` does all of this). "
        "Elsewhere: conda install -c conda-forge fenics-dolfinx, or dolfinx's containers. "
        f"The import failed with: {error}"
    ) from error

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError

if TYPE_CHECKING:
    from mpi4py import MPI


def create_mesh(comm: MPI.Comm, cells: Array, x: Array, cell_name: str) -> Any:
    """First-order mesh from arrays: cells (n, k) in dolfinx's node order and nodes x (m, gdim).

    In parallel every rank passes its own share of both.
    """
    gdim = x.shape[1]
    cells, x = np.asarray(cells, dtype=np.int64), np.asarray(x, dtype=np.float64)
    try:
        import basix.ufl

        element = basix.ufl.element("Lagrange", cell_name, 1, shape=(gdim,))
    except ImportError:
        element = ufl.VectorElement("Lagrange", ufl.Cell(cell_name, geometric_dimension=gdim), 1)
    args = list(inspect.signature(dolfinx.mesh.create_mesh).parameters)
    if args[2] == "x":
        return dolfinx.mesh.create_mesh(comm, cells, x, ufl.Mesh(element))
    return dolfinx.mesh.create_mesh(comm, cells, ufl.Mesh(element), x)


def function_space(
    mesh: Any, family: str = "Lagrange", degree: int = 1, shape: tuple[int, ...] = ()
) -> Any:
    """``dolfinx.fem.functionspace`` of every version; ``shape=(gdim,)`` for vectors."""
    if hasattr(dolfinx.fem, "functionspace"):
        return dolfinx.fem.functionspace(mesh, (family, degree, shape))
    # FFCx says so itself, after the first form of a mesh, which then is another one than the next.
    x = mesh.ufl_domain().ufl_coordinate_element()
    x = ufl.FiniteElement(x.family(), x.cell(), x.degree(), variant="equispaced")
    mesh.ufl_domain()._ufl_coordinate_element = ufl.VectorElement(x)
    space = dolfinx.fem.VectorFunctionSpace if shape else dolfinx.fem.FunctionSpace
    return space(mesh, (family, degree), *(shape or ())[:1])


def quadrature_space(mesh: Any, degree: int, shape: tuple[int, ...] = ()) -> Any:
    """Space of values, each of a shape, at the points of the quadrature rule of a degree."""
    try:
        import basix.ufl

        kind = cell_kinds(mesh)[0]
        element = basix.ufl.quadrature_element(kind, value_shape=shape, degree=degree)
    except ImportError:
        element = ufl.FiniteElement("Quadrature", mesh.ufl_cell(), degree, quad_scheme="default")
        element = ufl.TensorElement(element, shape=shape) if shape else element
    return getattr(dolfinx.fem, "functionspace", dolfinx.fem.FunctionSpace)(mesh, element)


def points_of(V: Any) -> Array | None:
    """(n, tdim) points of a ``quadrature_space`` on the reference cell; None of other spaces."""
    element = V.ufl_element()
    if hasattr(element, "has_custom_quadrature"):  # of Basix
        return element.custom_quadrature()[0] if element.has_custom_quadrature else None
    name, degree = element.family(), element.degree()
    return quadrature_points(V.mesh, degree) if name == "Quadrature" else None


def cell_dofs(space_or_geometry: Any) -> Array:
    """(n_cells, k) dofs of a function space's cells, or nodes of a mesh geometry's."""
    if hasattr(space_or_geometry, "dofmaps") and hasattr(space_or_geometry, "x"):
        dofmaps = space_or_geometry.dofmaps  # a mesh geometry, one dofmap per kind of cell
        dofmap = dofmaps(0) if callable(dofmaps) else dofmaps[0]
    else:
        dofmap = space_or_geometry.dofmap
    dofs = getattr(dofmap, "list", dofmap)
    if isinstance(dofs, np.ndarray):
        return dofs
    n = len(dofs.offsets) - 1
    # A rank may own no cell: then the width stands nowhere in the list.
    width = dofs.offsets[1] if n else getattr(dofmap, "dof_layout", None)
    return dofs.array.reshape(n, width if n else (width.num_dofs if width else 1))


def has_nodes(V: Any) -> bool:
    """Whether a function space's unknowns are values at nodes: Lagrange elements."""
    element = V.ufl_element()
    family = getattr(element, "element_family", None)  # of Basix
    name = element.family() if family is None else family.name
    return name in ("Lagrange", "P", "Q")


def tags_belong_to(tags: Any, mesh: Any) -> bool:
    """Whether mesh tags were made for this mesh."""
    if hasattr(tags, "topology"):
        return tags.topology == getattr(mesh.topology, "_cpp_object", mesh.topology)
    return tags.mesh.topology is mesh.topology or tags.mesh is mesh


def in_space(bc: Any, V: Any) -> bool:
    """Whether a Dirichlet condition acts on V or a part of it."""
    space = V._cpp_object
    return bc.function_space == space or space.contains(bc.function_space)


def same_space(V: Any, W: Any) -> bool:
    """Whether two function spaces are one."""
    return V is W or V._cpp_object == W._cpp_object


def entity_maps_of(given: Any, count: int) -> list[Any]:
    """Entity maps of so many forms: from dolfinx 0.10 on a list of EntityMap for all, before a dict
    for all or a list of dicts; ``ContactInputError`` where they do not fit."""
    if given is None:
        return [None] * count
    if "entity_maps" not in inspect.signature(dolfinx.fem.form).parameters:
        raise ContactInputError(
            f"entity_maps: dolfinx {dolfinx.__version__} has none, 0.8 and newer have: interpolate "
            "Functions of other meshes onto that of the form"
        )
    new, several = getattr(dolfinx.mesh, "EntityMap", None), isinstance(given, (list, tuple))
    each = list(given) if several and not new else [given] * count
    items = each[0] if new and several else each
    if len(each) != count or not all(isinstance(item, new or dict) for item in items):
        kind = "a list of dolfinx.mesh.EntityMap" if new else "a dict, or a list of one per form"
        checks.refuse("entity_maps", given, f"does not fit: give {kind}")
    return each


def form(name: str, ufl_form: Any, entity_maps: Any = None) -> Any:
    """Compiled form; ``ContactInputError`` where UFL or dolfinx cannot compile it."""
    options = {} if entity_maps is None else {"entity_maps": entity_maps}
    try:
        if ufl_form.arguments()[0].ufl_function_space().mesh.comm.size > 1:
            # First on every rank: newer UFL raises no Exception, which rank 0 alone would meet.
            lowered = apply_algebra_lowering(ufl_form)
            if not np.issubdtype(PETSc.ScalarType, np.complexfloating):
                lowered = remove_complex_nodes(lowered)  # v and conj(v) are one
            lowered = apply_derivatives(lowered)
            check_form_arity(lowered, ufl_form.arguments())
        return dolfinx.fem.form(ufl_form, **options)
    except (Exception, ArityMismatch) as error:
        text = " ".join(str(error).split())[:300]
        raise ContactInputError(f"the form {name} cannot be compiled: {text}") from error


def forms(name: str, ufl_forms: Sequence[Any], entity_maps: Sequence[Any]) -> list[Any]:
    """Compiled forms, with the entity maps of each."""
    return [form(name, *pair) for pair in zip(ufl_forms, entity_maps, strict=True)]


def assemble_matrix(a: Any, bcs: Sequence[Any], diagonal: float) -> PETSc.Mat:
    """Assembled PETSc AIJ of a compiled form; ``diagonal`` on the rows of ``bcs``."""
    given = inspect.signature(dolfinx.fem.petsc.assemble_matrix).parameters
    name = "diagonal" if "diagonal" in given else "diag"
    A = dolfinx.fem.petsc.assemble_matrix(a, bcs=bcs, **{name: diagonal})
    A.assemble()
    return A


def assemble_load(
    L: Any, a: Any, bcs: Sequence[Any], given: tuple[Array, ...], nodal: Sequence[Array]
) -> Array:
    """Owned entries of the load: compiled L plus nodal forces at owned dofs, lifted in the compiled
    form a by the conditions' values, which are ``given`` as ``prescribed`` finds them."""
    b, (fixed, values) = dolfinx.fem.petsc.assemble_vector(L), given
    if values[fixed].any():
        dolfinx.fem.petsc.apply_lifting(b, [a], [bcs])
    load = sum(nodal, summed(b))
    return np.where(fixed[: len(load)], values[: len(load)], load)


def assemble_force(forms: Sequence[Any], signs: Sequence[float], V: Any) -> Array:
    """Owned entries of the sum of compiled linear forms, with signs, without conditions."""
    none = np.zeros(V.dofmap.index_map.size_local * V.dofmap.index_map_bs)
    vectors = map(dolfinx.fem.petsc.assemble_vector, forms)
    return sum((sign * summed(b) for b, sign in zip(vectors, signs, strict=True)), none)


def summed(b: PETSc.Vec) -> Array:
    """Owned entries, with what other ranks have of them; the vector goes."""
    b.ghostUpdate(addv=PETSc.InsertMode.ADD_VALUES, mode=PETSc.ScatterMode.REVERSE)
    found: Array = b.array_r.copy()
    b.destroy()
    return found


def ghosted_vector(V: Any, bs: int) -> PETSc.Vec:
    """PETSc vector over V's nodes, ``bs`` entries each, with V's ghosts."""
    index_map = V.dofmap.index_map
    return PETSc.Vec().createGhost(
        index_map.ghosts.astype(PETSc.IntType),
        size=(index_map.size_local * bs, index_map.size_global * bs),
        bsize=bs,
        comm=V.mesh.comm,
    )


def prescribed_values(V: Any, bcs: Sequence[Any]) -> Array:
    """Values that the conditions prescribe, per owned and ghost dof; NaN where a dof is free."""
    return np.where(*prescribed(V, bcs), np.nan)


def prescribed(V: Any, bcs: Sequence[Any]) -> tuple[Array, Array]:
    """Whether conditions prescribe each owned and ghost dof, and which values."""
    n = V.dofmap.index_map_bs * ((nodes := V.dofmap.index_map).size_local + nodes.num_ghosts)
    b = dolfinx.fem.Function(V).x if V.mesh.comm.size > 1 else None  # it takes a communicator
    marks = np.repeat([[0.0], [1.0]], n, axis=1).astype(PETSc.ScalarType)
    for values in marks:  # a dof is fixed where the result does not depend on the start
        for bc in bcs:
            bc.set(values) if hasattr(bc, "set") else dolfinx.fem.set_bc(values, [bc])
        if b is not None:
            b.array[:] = values
            b.scatter_forward()
            values[:] = b.array
    return (marks[0] == marks[1]) | np.isnan(marks[0]), marks[0]


def evaluate(expression: Any, points: Array, mesh: Any, shape: tuple[int, ...] = ()) -> Array:
    """Values of UFL, or compiled for these reference points, in all local cells: (n_cells, ...)."""
    done = isinstance(expression, dolfinx.fem.Expression)
    compiled = expression if done else dolfinx.fem.Expression(expression, points)
    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    of = (mesh, cells) if "mesh" in inspect.signature(compiled.eval).parameters else (cells,)
    return compiled.eval(*of).reshape(len(cells), len(points), *shape)


def vtx_writer(comm: MPI.Comm, path: str | Path, u: Any) -> Any:
    """Open VTX file for a Function, or None where dolfinx is built without ADIOS2."""
    if not getattr(dolfinx.io, "VTXWriter", None) or not dolfinx.common.has_adios2:
        return None
    return dolfinx.io.VTXWriter(comm, str(path), [u], engine="BP4")  # which all ParaViews read


def io_module(*names: str) -> Any:
    """The first of these modules of dolfinx.io that this version has, or None."""
    there = [name for name in names if importlib.util.find_spec(f"dolfinx.io.{name}")]
    return importlib.import_module(f"dolfinx.io.{there[0]}") if there else None


def quadrature_points(mesh: Any, degree: int) -> Array:
    """Quadrature points on the reference cell of a mesh: (n, tdim)."""
    return basix.make_quadrature(getattr(basix.CellType, cell_kinds(mesh)[0]), degree)[0]


def cell_tree(mesh: Any, cells: Array) -> Any:
    """dolfinx's tree of the boxes of some local cells."""
    make = getattr(dolfinx.geometry, "bb_tree", dolfinx.geometry.BoundingBoxTree)
    return make(mesh, mesh.topology.dim, entities=cells)


def cell_kinds(mesh: Any) -> list[str]:
    """Names of the kinds of cells of a mesh; more than one in a mixed topology."""
    topology = mesh.topology
    kinds = getattr(topology, "entity_types", None)
    kinds = [topology.cell_type] if kinds is None else kinds[-1]
    return sorted({kind.name for kind in kinds})


def geometry_degree(mesh: Any) -> int:
    """Polynomial degree of a mesh's cells."""
    cmaps = getattr(mesh.geometry, "cmaps", None)
    if cmaps is not None and not callable(cmaps) and len(cmaps):
        return int(cmaps[0].degree)
    cmap = mesh.geometry.cmap
    return int((cmap() if callable(cmap) else cmap).degree)


def model_to_mesh(model: Any, comm: MPI.Comm, rank: int = 0, gdim: int = 3) -> tuple[Any, ...]:
    """gmsh model to (mesh, cell tags, facet tags)."""
    data = io_module("gmsh", "gmshio").model_to_mesh(model, comm, rank, gdim=gdim)
    return (data.mesh, data.cell_tags, data.facet_tags) if hasattr(data, "mesh") else data[:3]
