"""How pictures are drawn and saved: by PyVista in 3D where it is installed, else by Matplotlib."""

from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, depth_first_order

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.cells import outline_edges, vector_areas
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.overlap_flat import Plane, orthonormal_base
from dolfinx_llm.output import render
from dolfinx_llm.output.render import Scene
from dolfinx_llm.output.writing import writable_file, writing


def pyplot() -> Any:
    """Matplotlib's, without a display."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def save(plt: Any, figure: Any, path: str | Path) -> None:
    """Write a figure and let go of it; its folder is made."""
    path = Path(path)
    try:
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            figure.savefig(path, dpi=150, bbox_inches="tight")
    finally:
        plt.close(figure)


def on_root() -> bool:
    """Whether this rank draws."""
    return MPI.COMM_WORLD.rank == 0


def mean_plane(frame: Frame) -> Plane:
    """The plane that a flat frame lies in, or nearly."""
    normal = vector_areas(frame.x, frame.corners).sum(axis=0)
    normal /= np.linalg.norm(normal)
    return Plane(frame.x.mean(axis=0), orthonormal_base(normal))


def ways(x: Array, cells: Array) -> tuple[list[Array], Array]:
    """Nodes of each polyline in their order, and (n,) the length of the way to every node: along
    one polyline after the other.

    Args:
        x: (n, 2) nodes [length].
        cells: (f, 2) their segments' nodes, or (f, 3) with the middle last.
    """
    segments = cells[:, [0, -1, -1, 1]].reshape(-1, 2) if cells.shape[1] == 3 else cells
    n = len(x)
    near = csr_matrix((np.ones(len(segments)), segments.T), (n, n))
    pieces, of = connected_components(near, directed=False)
    ends = np.isin(np.arange(n), outline_edges(segments))
    found, s, end = [], np.zeros(n), 0.0
    for piece in range(pieces):
        nodes = np.flatnonzero(of == piece)
        first = nodes[np.lexsort((*x[nodes].T[::-1], ~ends[nodes]))[0]]
        order = depth_first_order(near, first, directed=False, return_predecessors=False)
        way = np.linalg.norm(np.diff(x[order], axis=0), axis=1)
        s[order] = end + np.concatenate([[0.0], np.cumsum(way)])
        end = float(s[order[-1]])
        found.append(order)
    return found, s


def draw_cells(axis: Any, s: Array, cells: Array) -> None:
    """Outlines and nodes (m, 2) of cells (n, k)."""
    from matplotlib.collections import PolyCollection

    axis.add_collection(PolyCollection(s[cells], facecolors="none", edgecolors="k", linewidths=1))
    axis.plot(*s.T, "ks", markersize=3)


def draw_scene(scene: Scene, path: str | Path) -> None:
    """Scenes in 3D by PyVista where it is installed and can; Matplotlib otherwise, and in 2D."""
    path = writable_file("path", path)
    if scene.points.shape[1] == 3 and path.suffix == ".png" and render.draw(scene, path):
        return
    plt = pyplot()
    figure, norm, cmap = plt.figure(figsize=(8, 6)), plt.Normalize(*scene.limits), "viridis"
    if scene.named is not None:
        from matplotlib.colors import BoundaryNorm, ListedColormap

        n = len(scene.named)
        norm, cmap = BoundaryNorm(np.arange(n + 1) - 0.5, n), ListedColormap(render.SHADES[:n])
    per_cell = scene.values
    if len(scene.values) == len(scene.points):
        per_cell = scene.values[scene.cells].mean(axis=1)
    if scene.view is not None:
        _draw_flat(figure, scene, scene.view, norm, cmap)
    else:
        _draw_skin(figure, scene, plt.get_cmap(cmap)(norm(per_cell)))
    bar = plt.cm.ScalarMappable(norm, cmap)
    figure.axes[0].set_title(scene.label, fontsize="medium")  # longer than flat bodies are high
    told = figure.colorbar(
        bar,
        ax=figure.axes,
        shrink=0.7,
        pad=0.05 if scene.points.shape[1] == 2 or scene.view is not None else 0.12,
        label=scene.label.split(" (")[0].split(";")[0],
    )
    if scene.named is not None:
        told.set_ticks(np.arange(len(scene.named)), labels=list(scene.named))
    save(plt, figure, path)


def _draw_flat(figure: Any, scene: Scene, normal: Array, norm: Any, cmap: Any) -> None:
    """A flat surface seen along its normal."""
    plane = Plane(scene.points.mean(axis=0), orthonormal_base(normal))
    axis, s, cells = figure.add_subplot(), plane.project(scene.points), scene.cells
    triangles = np.concatenate([cells[:, [0, i, i + 1]] for i in range(1, cells.shape[1] - 1)])
    if scene.named is not None:
        of_cells = np.tile(scene.values, cells.shape[1] - 2)
        axis.tripcolor(*s.T, triangles, facecolors=of_cells, norm=norm, cmap=cmap)
    else:
        axis.tripcolor(*s.T, triangles, scene.values, shading="gouraud", norm=norm, cmap=cmap)
    _draw_marks(axis, s, scene.status)


def _draw_marks(axis: Any, x: Array, status: Array | None) -> None:
    """The status of points (n, 2) or (n, 3), with a legend below."""
    for k, (name, colour) in enumerate(render.STATUS.items()):
        at = np.flatnonzero(status == k)
        if len(at):
            axis.plot(*x[at].T, "o", color=colour, mec="k", mew=0.5, markersize=3, label=name)
    axis.set_aspect("equal")
    if status is not None:
        below: Any = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0), "borderaxespad": 2.5}
        axis.legend(ncol=4, facecolor="0.85", **below)  # however flat bodies are


def _draw_skin(figure: Any, scene: Scene, colours: Array) -> None:
    """Polygons, or lines in the plane, in their colours; bodies around them and the outline."""
    from matplotlib.collections import LineCollection, PolyCollection
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    flat, polygons = scene.points.shape[1] == 2, scene.points[scene.cells]
    poly, line = (PolyCollection, LineCollection) if flat else (Poly3DCollection, Line3DCollection)
    axis = figure.add_subplot() if flat else figure.add_subplot(projection="3d")
    parts: list[Any] = []
    if scene.body is not None:
        faint = {"alpha": 1.0 if flat else 0.15, "edgecolors": "0.7", "linewidths": 0.2}
        parts.append(poly(scene.body, facecolors="aliceblue", **faint))
    if polygons.shape[1] == 2:
        parts.append(line(polygons, colors=colours, linewidths=4.0))
    else:
        parts.append(poly(polygons, facecolors=colours, edgecolors="k", linewidths=0.1))
    if scene.outline is not None and len(scene.outline):
        parts.append(line(scene.outline, colors="0.5", linewidths=0.8, linestyles="dashed"))
    for part in parts:
        axis.add_collection(part) if flat else axis.add_collection3d(part)
    around = [p for p in (polygons, scene.body, scene.outline) if p is not None and len(p)]
    x = np.concatenate([p.reshape(-1, p.shape[2]) for p in around])
    low, high = x.min(axis=0), x.max(axis=0)
    for k, name in enumerate("xyz"[: len(low)]):
        room = 0.03 * (high - low).max() * flat
        getattr(axis, f"set_{name}lim")(low[k] - room, high[k] + room)
    _draw_marks(axis, scene.points, scene.status)
    if not flat:
        axis.set_aspect("auto")
        # Room for what stands out of the box when it is turned, and for numbers along short edges.
        axis.set_box_aspect(np.maximum(high - low, 1e-3 * (high - low).max()), zoom=0.85)
        for k, name in enumerate("xyz"):
            part = (high - low)[k] / (high - low).max()
            getattr(axis, f"{name}axis").get_major_locator().set_params(
                nbins=max(1, round(5 * part))
            )
