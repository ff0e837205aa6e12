"""Coloured surfaces in 3D drawn by PyVista, in a process of its own.

Without a working OpenGL, VTK may end the process that it draws in, or hang: that must not be a
simulation, nor a rank of one. Run as a script this module draws the scene that it reads from its
standard input, and it imports nothing of this package: VTK 9.7 aborts beside dolfinx's libraries.
"""

from __future__ import annotations

import io
import logging
import os
import re
import subprocess
import sys
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from dolfinx_llm.base.arrays import Array

log = logging.getLogger("dolfinx_llm")

SECONDS = 120.0  # that a picture may take
PIXELS = (1600, 1200)  # [pixel]
ABOVE = (0.43, -0.75, 0.5)  # from where a scene is seen
# Colours of marks 0, 1, 2, 3.
STATUS = {"open": "white", "stick": "black", "slip": "red", "closed": "blue"}
SHADES = ("gainsboro", "darkgray", "lightsalmon", "lightsteelblue")  # of cells by their status
# What launchers leave in a rank's environment; an MPI in the new process would take it for its own.
LAUNCHERS = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDRA_", "MPI_LOCAL")

_failed = False  # PyVista, in this process: it is not asked again


@dataclass(frozen=True, eq=False)
class Scene:
    """A coloured surface, in 2D in the plane or a line there, and what stands around it."""

    points: Array  # (n, 3) [length]
    cells: Array  # (m, k) their corners, in a cycle
    values: Array  # (m,) per cell or (n,) per point
    limits: tuple[float, float]  # of the colours
    label: str  # of the colour bar
    view: Array | None = None  # (3,) where a flat surface is seen from; None: it is not
    status: Array | None = None  # (n,) marks at the points: 0 open, 1 stick, 2 slip, 3 closed
    outline: Array | None = None  # (l, 2, 3) edges of what is not deformed
    body: Array | None = None  # (b, k, 3) polygons around the surface, translucent
    seen_from: Any = ABOVE  # (3,) a surface that is not flat
    named: Array | None = None  # what values 0, 1, ... are called, in SHADES; None: numbers


def draw(scene: Scene, path: Path) -> bool:
    """Draw a scene as PNG by PyVista, if it is installed and can; say whether it has."""
    global _failed
    if _failed or find_spec("pyvista") is None:
        return False
    why = asked(scene, path)
    if why:
        _failed = True
        log.warning("PyVista cannot draw here (%s): pictures by Matplotlib instead", why)
    return not why


def asked(scene: Scene, path: Path) -> str:
    """Have PyVista draw a scene as PNG, or as a page (HTML); what it fails with, "" if it does
    not."""
    data = io.BytesIO()
    np.savez(data, **{key: value for key, value in asdict(scene).items() if value is not None})
    environment = {k: v for k, v in os.environ.items() if not k.startswith(LAUNCHERS)}
    command = [sys.executable, "-P", __file__, str(path)]
    try:
        done = subprocess.run(
            command, input=data.getvalue(), env=environment, capture_output=True, timeout=SECONDS
        )
        if done.returncode == 0:
            return ""
        words = done.stderr.decode(errors="replace").strip().splitlines()
        words += [line for line in words if re.match(r"[\w.]+(Error|Exception)\b", line)][-1:]
        return f"exit code {done.returncode}" + (f", {words[-1]}" if words else "")
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)


def _draw(scene: dict[str, Any], path: str) -> None:
    """Write the picture of a scene's fields."""
    import pyvista

    points, cells, view = scene["points"], scene["cells"], scene.get("view")
    faces = np.column_stack([np.full(len(cells), cells.shape[1]), cells])
    bar: dict[str, Any] = {"n_labels": 5, "fmt": "%.4g"}
    colours: dict[str, Any] = {"clim": list(scene["limits"]), "cmap": "viridis"}
    if "named" in scene:
        n = len(scene["named"])
        bar = {"n_labels": 0, "position_y": 0.06}
        colours = {"clim": [-0.5, n - 0.5], "cmap": list(SHADES[:n]), "n_colors": n}
        colours["annotations"] = {float(k): str(name) for k, name in enumerate(scene["named"])}
    plotter = pyvista.Plotter(off_screen=True, window_size=list(PIXELS))
    plotter.set_background("white")
    plotter.add_mesh(
        pyvista.PolyData(points, faces.ravel()),
        scalars=scene["values"],
        **colours,
        show_edges=True,
        edge_color="black",
        line_width=1.0,
        lighting="status" not in scene,  # which would change the colours of an interface
        ambient=0.35,
        diffuse=0.65,
        scalar_bar_args={
            # In VTK | begins a column; an empty line keeps the numbers from the title.
            "title": str(scene["label"]).replace("|", "") + "\n ",
            "color": "black",
            "title_font_size": 32, "label_font_size": 28,
            "position_x": 0.2, "position_y": 0.03, "width": 0.65, "height": 0.12, **bar,
        },
    )  # fmt: skip
    if "body" in scene:
        corners, k = scene["body"].reshape(-1, 3), scene["body"].shape[1]
        faces = np.column_stack(
            [np.full(len(corners) // k, k), np.arange(len(corners)).reshape(-1, k)]
        )
        body = pyvista.PolyData(corners, faces.ravel())
        plotter.add_mesh(
            body, color="lightsteelblue", opacity=0.25, show_edges=True, line_width=0.5
        )
    if len(scene.get("outline", ())):
        ends = scene["outline"].reshape(-1, 3)
        lines = np.insert(np.arange(len(ends)).reshape(-1, 2), 0, 2, axis=1)
        edges = pyvista.PolyData(ends, lines=lines.ravel())
        plotter.add_mesh(edges, color="gray", line_width=2.0)
    for k, (name, colour) in enumerate(STATUS.items()):
        at = scene.get("status", np.empty(0)) == k
        if at.any():
            plotter.add_points(
                points[at], color=colour, point_size=12.0, render_points_as_spheres=True, label=name
            )
    if "status" in scene:
        plotter.add_legend(bcolor="gray", face="circle", size=(0.13, 0.13))
    plotter.add_axes(color="black")
    if view is None:
        plotter.view_vector(scene["seen_from"], viewup=(0.0, 0.0, 1.0))
    else:
        plotter.view_vector(view, viewup=np.eye(3)[1 if abs(view[2]) > 0.9 else 2])
    plotter.enable_parallel_projection()
    plotter.camera.zoom(0.85 if view is None else 1.0)
    if path.endswith(".html"):
        plotter.export_html(path)
        return
    plotter.camera.SetWindowCenter(0.0, -0.12)  # room for the colour bar
    picture = plotter.screenshot(path)
    plotter.close()
    if np.ptp(picture) == 0:
        raise RuntimeError("the picture is blank")


if __name__ == "__main__":
    with np.load(io.BytesIO(sys.stdin.buffer.read())) as arrays:
        _draw(dict(arrays), sys.argv[1])
