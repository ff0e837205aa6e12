"""Pictures as PNG, without a display. Libraries are imported when a picture is made.

Scenes in 3D are drawn by PyVista where it is installed and can draw, all else by Matplotlib.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx.fem import Function
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinx_llm.base import checks
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.geometry.cells import vector_areas
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.interface.forces import InterfaceForces
from dolfinx_llm.output import render
from dolfinx_llm.output.bodies import Seen, checked_view, commonest
from dolfinx_llm.output.drawing import (
    draw_cells,
    draw_scene,
    mean_plane,
    on_root,
    pyplot,
    save,
    ways,
)
from dolfinx_llm.output.film import Film
from dolfinx_llm.output.render import Scene
from dolfinx_llm.output.values import check_displacement, check_result
from dolfinx_llm.output.writing import writable_file

__all__ = ["Film", "bodies", "curves", "frame_design", "interface"]

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
    lines: Sequence[Any],
    path: str | Path,
    *,
    xlabel: str = "",
    ylabel: str = "",
    title: str = "",
    log: bool = False,
) -> None:
    """Curves and points in one diagram, e.g. pressure along a contact against theory.

    Draws on rank 0 when called on all ranks.

    Args:
        lines: sequence of (label, Matplotlib's style, x, y), or of lists of these for several
            diagrams side by side.
        path: PNG to write.
        xlabel, ylabel, title: of all diagrams.
        log: whether both axes are logarithmic.

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
    checks.instance("log", log, bool, "give True or False")
    writable_file("path", path, PICTURES)
    if not on_root():
        return
    plt = pyplot()
    figure, axes = plt.subplots(1, len(diagrams), figsize=(6.5 * len(diagrams), 5), squeeze=False)
    for axis, diagram in zip(axes[0], diagrams):
        for label, style, x, y in diagram:
            axis.plot(x, y, style, label=label, markersize=4, linewidth=1)
        axis.set(xlabel=xlabel, ylabel=ylabel, title=title)
        if log:
            axis.set(xscale="log", yscale="log")
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
    u: Function | Sequence[Function],
    expression: Expr | Sequence[Expr],
    path: str | Path,
    *,
    label: str = "",
    scale: float | None = None,
    section: Sequence[Any] | None = None,
) -> None:
    """Deformed bodies of all meshes coloured by a scalar (paper, Figure 13), with the outline of
    the undeformed ones. Collective.

    Args:
        u: displacement Function of a mesh in 3D or 2D, or a sequence of them.
        expression: scalar UFL expression, its largest value per cell is shown; one per mesh.
        path: PNG to write.
        label: of the colour bar.
        scale: factor on the displacement; None: such that it is a tenth of the size at most, or 1.
        section: (point, normal) of a plane in 3D: cells in front of it are left out; None: none.

    Raises:
        ContactInputError: arguments of other types, or a path that cannot be written; on all ranks.
    """
    motions: list[Any] = list(u) if isinstance(u, (list, tuple)) else [u]
    given = expression if isinstance(expression, (list, tuple)) else [expression]
    for motion in motions or checks.refuse("u", u, "give a displacement, or a list of them"):
        comm = check_displacement(motion)
    with collective(comm):
        writable_file("path", path, PICTURES)
        checks.instance("label", label, str, "give a text")
        if len(given) != len(motions):
            raise ContactInputError(
                f"{len(motions)} displacements, {len(given)} expressions: give one per mesh"
            )
        gdim, told = motions[0].function_space.mesh.geometry.dim, iter(given)
        view = checked_view(lambda _: next(told), scale, section, gdim, label)
    draw_seen(comm, view.seen(comm, motions, []), path)


def draw_seen(comm: MPI.Comm, seen: Seen | None, path: str | Path) -> None:
    """Draw what rank 0 has; collective."""
    with collective(comm):
        if seen is not None:
            draw_scene(seen.scene(), path)


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


def draw_interface(result: InterfaceForces, path: str | Path, field: str) -> None:
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
        scene = Scene(moved, frame.corners, value, limits, label, view, result.frame_status)
        if field == "status":
            scene = replace(
                scene,
                values=commonest(result.frame_status[frame.corners]),
                label="status",
                named=np.array(list(render.STATUS)),
            )
        draw_scene(scene, path)
        return
    plt = pyplot()
    figure = plt.figure(figsize=(7, 5))
    axis, (pieces, s) = figure.add_subplot(), ways(x, frame.cells)
    for order in pieces:
        axis.plot(s[order], value[order], "-", color="0.6")
    for k, (name, colour) in enumerate(render.STATUS.items()):
        at = result.frame_status == k
        if not at.any():
            continue
        axis.plot(s[at], value[at], "o", color=colour, mec="k", label=name)
    axis.set(xlabel="distance along the contact", ylabel=field)
    axis.axhline(0.0, color="0.8", linewidth=0.8, zorder=0)  # where pressures count from
    if field == "status":
        axis.set_yticks(np.arange(len(render.STATUS)), labels=list(render.STATUS))
    axis.legend()
    save(plt, figure, path)
