"""Pictures as PNG, without a display. Libraries are imported when a picture is made.

Scenes in 3D are drawn by PyVista where it is installed and can draw, all else by Matplotlib.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx.fem import Function
from dolfinx.mesh import exterior_facet_indices
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.geometry.cells import vector_areas
from dolfinx_llm.geometry.element import element_of
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.surface import facet_nodes
from dolfinx_llm.interface.forces import InterfaceForces
from dolfinx_llm.output import render
from dolfinx_llm.output.drawing import (
    draw_cells,
    draw_scene,
    mean_plane,
    on_root,
    pyplot,
    save,
    ways,
)
from dolfinx_llm.output.render import Scene
from dolfinx_llm.output.values import cell_maximum, check_displacement, check_result, displacement
from dolfinx_llm.output.writing import writable_file, writable_folder

FIELDS = ("pressure", "status", "traction")  # of an interface
PICTURES = (".png", ".pdf", ".svg")
LINES = "give a list of (label, style, x, y), or a list of such lists"
FLAT = 0.98  # sum of vector areas over area, from which a surface is seen along its normal


def frame_design(result: InterfaceForces, before: Frame | None, path: str | Path) -> None:
    """Frame before and after design with both sides' nodes and forces (paper, Figures 11, 12).

    Draws on rank 0 when called on all ranks.

    Args:
        result: of an interface between flat surfaces in 3D.
        before: the frame's prediction, or None.
        path: PNG to write.

    Raises:
        ContactInputError: the interface has no frame, but a rigid obstacle, or lies in 2D;
            arguments of other types, or a path that cannot be written.
    """
    check_result(result)
    if result.frame is None:
        raise ContactInputError("against a rigid obstacle there is no frame to draw")
    if before is not None:
        checks.instance("before", before, Frame, "give a dolfinx_llm.Frame or None")
    if {frame.gdim for frame in (result.frame, before) if frame is not None} != {3}:
        raise ContactInputError("frames are drawn in 3D; of 2D scenes draw plot.interface")
    writable_file("path", path, PICTURES)
    if not on_root():
        return
    plt = pyplot()
    plane = mean_plane(result.frame)
    frames: list[tuple[str, Any]] = [("prediction", before)] if before is not None else []
    frames.append(("frame", result.frame))
    figure, axes = plt.subplots(1, len(frames), figsize=(6.5 * len(frames), 6), squeeze=False)
    largest = max(side.normal_force.max() for side in result.sides)
    for axis, (title, frame) in zip(axes[0], frames):
        s = plane.project(frame.x)
        draw_cells(axis, s, frame.corners)
        for k, side in enumerate(result.sides):
            p = plane.project(side.x)
            size = 120.0 * np.maximum(side.normal_force, 0.0) / largest
            axis.scatter(*p.T, s=size, alpha=0.45, color=f"C{k}", label=f"side {k}: force")
            axis.plot(*p.T, "." if k else "x", color=f"C{k}", markersize=4)
        axis.set(aspect="equal", title=f"{title}: {len(frame.x)} nodes, {len(frame.cells)} cells")
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.06), ncol=2, fontsize=8)
    save(plt, figure, path)


def curves(
    lines: Sequence[Any], path: str | Path, *, xlabel: str = "", ylabel: str = "", title: str = ""
) -> None:
    """Curves and points in one diagram, e.g. pressure along a contact against theory.

    Draws on rank 0 when called on all ranks.

    Args:
        lines: sequence of (label, Matplotlib's style, x, y), or of lists of these for several
            diagrams side by side.
        path: PNG to write.
        xlabel, ylabel, title: of all diagrams.

    Raises:
        ContactInputError: lines of another form, or a path that cannot be written.
    """
    given = checks.items("lines", lines, LINES)
    diagrams = given if given and isinstance(given[0], list) else [given]
    for diagram in diagrams:
        for line in checks.items("lines", diagram, LINES) or checks.refuse("lines", lines, LINES):
            _check_line(line)
    for name, text in (("xlabel", xlabel), ("ylabel", ylabel), ("title", title)):
        checks.instance(name, text, str, "give a text")
    writable_file("path", path, PICTURES)
    if not on_root():
        return
    plt = pyplot()
    figure, axes = plt.subplots(1, len(diagrams), figsize=(6.5 * len(diagrams), 5), squeeze=False)
    for axis, diagram in zip(axes[0], diagrams):
        for label, style, x, y in diagram:
            axis.plot(x, y, style, label=label, markersize=4, linewidth=1)
        axis.set(xlabel=xlabel, ylabel=ylabel, title=title)
        axis.legend(fontsize=8)
    save(plt, figure, path)


def _check_line(line: Any) -> None:
    """Require (label, style, x, y) with as many numbers in x as in y."""
    if not isinstance(line, (tuple, list)) or len(line) != 4:
        checks.refuse("lines: line", line, LINES)
    label, style, *xy = line
    checks.instance("lines: label", label, str, LINES)
    checks.instance("lines: style", style, str, 'give a style of Matplotlib such as "C0o-"')
    try:
        from matplotlib.figure import Figure

        Figure().add_subplot().plot([], [], style)
    except ValueError:
        checks.refuse("lines: style", style, 'give a style of Matplotlib such as "C0o-"')
    x, y = (np.asarray(values) for values in xy)
    for name, values in (("x", x), ("y", y)):
        if values.ndim != 1 or values.dtype.kind not in "iuf":
            checks.refuse(f"lines: {name} of {label!r}", values, "give a list of numbers")
    if x.shape != y.shape:
        raise ContactInputError(f"lines: {label!r} has {len(x)} x and {len(y)} y: give as many")


def bodies(
    u: Function, expression: Expr, path: str | Path, *, label: str = "", scale: float | None = None
) -> None:
    """Deformed bodies coloured by a scalar (paper, Figure 13). Collective.

    Args:
        u: displacement Function of a mesh in 3D or 2D.
        expression: scalar UFL expression, its largest value per cell is shown.
        path: PNG to write.
        label: of the colour bar.
        scale: factor on the displacement; None: such that it is a tenth of the size at most, or 1.

    Raises:
        ContactInputError: arguments of other types, or a path that cannot be written; on all ranks.
    """
    comm = check_displacement(u)
    with collective(comm):
        writable_file("path", path, PICTURES)
        checks.instance("label", label, str, "give a text")
        if scale is not None:
            scale = checks.number("scale", scale, "give a finite number or None")
    field = cell_maximum(expression, u.function_space.mesh)
    gathered = comm.gather(_skin(u, field), root=0)
    with collective(comm):
        if gathered is not None:
            _draw_bodies(gathered, label, scale, path)


def pictures(
    comm: MPI.Comm,
    u: Sequence[Function],
    results: Sequence[InterfaceForces],
    folder: str | Path,
    field: str = "pressure",
    scale: float | None = None,
) -> None:
    """What ``ContactProblem.plot`` draws; collective.

    Args:
        comm: MPI communicator.
        u: solution of each mesh.
        results: of each interface.
        folder: where the pictures go; it is made.
        field: of ``interface``.
        scale: of ``bodies``.

    Raises:
        ContactInputError: no such field, or a folder that cannot be written; on all ranks.
    """
    with collective(comm):
        checks.one_of("field", field, FIELDS)
        place = writable_folder("folder", folder)
    for i, motion in enumerate(map(displacement, u)):
        length = ufl.sqrt(ufl.inner(motion, motion))
        bodies(motion, length, place / f"bodies_{i}.png", label="length of u", scale=scale)
    with collective(comm):
        for i, result in enumerate(results if comm.rank == 0 else []):
            draw_interface(result, place / f"interface_{i}.png", field)


def _draw_bodies(gathered: list[Any], label: str, scale: float | None, path: str | Path) -> None:
    """Bodies of what ``_skin`` gives on every rank."""
    x, v, values = (np.concatenate(part) for part in zip(*gathered))
    if scale is None:
        size, motion = np.ptp(x.reshape(-1, x.shape[2]), axis=0).max(), np.abs(v).max()
        scale = 1.0 if motion > 0.02 * size or motion == 0.0 else 0.05 * size / motion
    low, high = values.min(), values.max()
    if high - low < 1e-6 * max(abs(high), 1e-300):  # constant: do not paint rounding
        low, high = low - 0.5 * abs(low) - 1e-300, high + 0.5 * abs(high) + 1e-300
    label = f"{label} ({values.min():.6g} to {values.max():.6g}); displacement × {scale:.3g}"
    polygons = x + scale * v
    cells = np.arange(polygons.shape[0] * polygons.shape[1]).reshape(polygons.shape[:2])
    draw_scene(Scene(polygons.reshape(-1, x.shape[2]), cells, values, (low, high), label), path)


def _skin(u: Function, field: Function) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """This rank's outer facets (cells in 2D): corners, their displacement, the cell's value."""
    V, mesh = u.function_space, u.function_space.mesh
    tdim, gdim = mesh.topology.dim, mesh.geometry.dim
    dofs = compat.cell_dofs(V)
    values = field.x.array[compat.cell_dofs(field.function_space)[:, 0]]
    n_owned = mesh.topology.index_map(tdim).size_local
    layout = V.dofmap.dof_layout
    if tdim == 2:
        order = [0, 1, 2] if layout.num_dofs in (3, 6) else [0, 1, 3, 2]
        nodes, cells = dofs[:n_owned][:, order], np.arange(n_owned)
    else:
        mesh.topology.create_connectivity(2, 3)
        mesh.topology.create_connectivity(3, 2)
        outer = exterior_facet_indices(mesh.topology)
        cells, corners = facet_nodes(V, outer)
        corners = corners[:, : element_of(2, corners.shape[1]).corners]
        nodes = dofs[cells[:, None], corners][cells < n_owned]
        cells = cells[cells < n_owned]
    x = V.tabulate_dof_coordinates()[:, :gdim]
    motion = u.x.array.reshape(-1, gdim)
    return x[nodes], motion[nodes], values[cells]


def interface(result: InterfaceForces, path: str | Path, field: str = "pressure") -> None:
    """A field of an interface: over the contact in 2D, on the deformed frame in 3D.

    Draws on rank 0 when called on all ranks. Marks show the status: open, stick or slip.

    Args:
        result: an ``InterfaceResult``.
        path: PNG to write.
        field: "pressure", "status", or "traction" (its length).

    Raises:
        ContactInputError: there is no such field, result is none, or the path cannot be written.
    """
    check_result(result)
    checks.one_of("field", field, FIELDS)
    writable_file("path", path, PICTURES)
    if on_root():
        draw_interface(result, path, field)


def draw_interface(result: InterfaceForces, path: str | Path, field: str = "pressure") -> None:
    """What ``interface`` draws, on this rank.

    Args:
        result, path, field: as of ``interface``.
    """
    values = {
        "pressure": result.pressure,
        "status": result.frame_status.astype(float),
        "traction": np.linalg.norm(result.traction, axis=1),
    }
    x, value, side = result.x, values[field], result.sides[0]
    frame, moved = result.frame or Frame(x, side.facets), result.deformed
    if x.shape[1] == 3:
        label, low = f"{field} ({value.min():.6g} to {value.max():.6g})", min(value.min(), 0.0)
        limits = low, max(value.max(), low + 1e-300)
        areas = vector_areas(moved, frame.corners)
        flat = np.linalg.norm(areas.sum(axis=0)) > FLAT * np.linalg.norm(areas, axis=1).sum()
        view = mean_plane(frame).normal if flat else None
        if view is not None and view @ render.ABOVE < 0.0:
            view = -view
        draw_scene(
            Scene(moved, frame.corners, value, limits, label, view, result.frame_status), path
        )
        return
    plt = pyplot()
    figure = plt.figure(figsize=(7, 5))
    axis, (pieces, s) = figure.add_subplot(), ways(x, frame.cells)
    for order in pieces:
        axis.plot(s[order], value[order], "-", color="0.6")
    for k, name in enumerate(render.STATUS):
        at = result.frame_status == k
        axis.plot(s[at], value[at], f"C{k}o", mfc=None if k else "none", label=name)
    axis.set(xlabel="distance along the contact", ylabel=field)
    axis.legend()
    save(plt, figure, path)
