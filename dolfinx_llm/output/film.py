"""Load steps as a film."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from dolfinx_llm.base import checks
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.output import render
from dolfinx_llm.output.bodies import Seen, checked_view, suited_scale
from dolfinx_llm.output.drawing import draw_scene
from dolfinx_llm.output.render import Scene
from dolfinx_llm.output.values import check_problem, displacements
from dolfinx_llm.output.writing import writable_file, writing

LONGEST_SHOWN = 600.0  # [s] that a step is shown: a GIF counts in hundredths, up to 65535
SHOWN = f"give seconds, from 0.01 to {LONGEST_SHOWN:g}"
# A page that shows one of several pages, each in base64, as a slider says.
PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>%(title)s</title><style>
body { margin: 0; font: 15px sans-serif; } iframe { width: 100vw; height: 88vh; border: 0; }
p { margin: .3rem 1rem; } input { width: 60vw; }
</style></head><body>
<p>step <b id="step"></b> <input id="slider" type="range" min="0" value="0"></p>
<p id="label"></p><iframe id="shown"></iframe>
<script>
const steps = %(steps)s, slider = document.getElementById("slider");
function show() {
  const [label, page] = steps[slider.value];
  const bytes = Uint8Array.from(atob(page), c => c.charCodeAt(0));
  const blob = new Blob([bytes], {type: "text/html"});
  document.getElementById("step").textContent = slider.value;
  document.getElementById("label").textContent = label;
  document.getElementById("shown").src = URL.createObjectURL(blob);
}
slider.max = steps.length - 1; slider.onchange = show; show();
</script></body></html>
"""


class Film:
    """A film of a problem's load steps, with one scale and one range of colours; drawn when it is
    closed. All calls are collective.

    Args:
        problem: the ``ContactProblem``, or the ``NonlinearContactProblem``.
        path: .gif to write; or .html, in 3D: a page for browsers, in which each step can be turned,
            by PyVista's HTML export (``pip install "pyvista[jupyter]"``).
        colour, scale, section: as of ``ContactProblem.plot``.
        seconds: for which a step is shown, 0.01 to 600 [s].

    Raises:
        ContactInputError: arguments of other types, or a path that cannot be written; a page in 2D,
            or without what exports it.

    Example::

        with llm.plot.Film(problem, "out/drag.gif") as film:
            for drag.value in (0.0, 0.001, 0.002):
                problem.solve()
                film.add()
    """

    def __init__(
        self,
        problem: Any,
        path: str | Path,
        *,
        colour: Any = "pressure",
        scale: float | None = None,
        section: Sequence[Any] | None = None,
        seconds: float = 0.5,
    ):
        check_problem(problem)
        with collective(problem.comm):
            gdim = problem.spaces[0].mesh.geometry.dim
            scale = problem.suited_scale if scale is None else scale
            self._view = checked_view(colour, scale, section, gdim)
            self._path = writable_file("path", path, (".gif", ".html"))
            if self._path.suffix == ".html":
                _check_page(gdim)
            self._seconds = checks.number("seconds", seconds, SHOWN, low=0.01)
            if self._seconds > LONGEST_SHOWN:
                checks.refuse("seconds", seconds, SHOWN)
        self._problem = problem
        self._seen: list[Seen | None] = []

    def add(self) -> None:
        """Add the last solve.

        Raises:
            ContactError: nothing has been solved.
        """
        if not self._problem.results:
            raise ContactError("there is nothing to draw yet: call solve() first")
        u = displacements(self._problem.u)
        self._seen.append(self._view.seen(self._problem.comm, u, self._problem.results))

    def close(self) -> None:
        """Draw what was added; leaving a ``with`` block does so, too. May be called again.

        Raises:
            ContactError: PyVista cannot export a page here; on all ranks.
        """
        seen, self._seen = self._seen, []
        with collective(self._problem.comm):
            self._draw([one for one in seen if one is not None])

    def _draw(self, seen: list[Seen]) -> None:
        """Write the film of what this rank has."""
        if not seen:
            return
        scale = min(suited_scale(one.skins) for one in seen)
        scenes = [one.scene(scale if self._view.scale is None else None) for one in seen]
        limits = min(s.limits[0] for s in scenes), max(s.limits[1] for s in scenes)
        scenes = [replace(scene, limits=limits) for scene in scenes]
        write = self._write_page if self._path.suffix == ".html" else self._write_gif
        with TemporaryDirectory() as folder:
            write(scenes, [Path(folder) / f"{i}.png" for i in range(len(scenes))])

    def _write_page(self, scenes: list[Scene], files: list[Path]) -> None:
        """Write the page, by files for its parts."""
        steps = []
        for scene, file in zip(scenes, files):
            part = file.with_suffix(".html")
            why = render.asked(scene, part)
            if why:
                raise ContactError(f"PyVista cannot export a page here ({why}): write .gif instead")
            told = "{:.4g} (dark) to {:.4g} (bright)".format(*scene.limits)
            if scene.named is not None:
                told = ", ".join(f"{c}: {n}" for c, n in zip(render.SHADES, scene.named))
            label = f"{scene.label}; colours {told}"  # pages have no colour bar
            steps.append((label, base64.b64encode(part.read_bytes()).decode()))
        text = PAGE % {"title": self._path.stem, "steps": json.dumps(steps)}
        with writing(self._path):
            self._path.write_text(text, encoding="utf-8")

    def _write_gif(self, scenes: list[Scene], files: list[Path]) -> None:
        """Write the animation, by files for its pictures."""
        from PIL import Image  # which Matplotlib needs

        for scene, file in zip(scenes, files):
            draw_scene(scene, file)
        with writing(self._path):
            first, *others = (Image.open(file).convert("RGB") for file in files)
            others = [image.resize(first.size) for image in others]
            first.save(
                self._path,
                save_all=True,
                append_images=others,
                duration=int(1000 * self._seconds),
                loop=0,
            )

    def __enter__(self) -> Film:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _check_page(gdim: int) -> None:
    """Require what a page for browsers needs."""
    if gdim != 3:
        raise ContactInputError("pages show scenes in 3D; in 2D write .gif")
    missing = [name for name in ("pyvista", "trame_vtk") if find_spec(name) is None]
    if missing:
        raise ContactInputError(
            f"pages are exported by PyVista, and {' and '.join(missing)} cannot be found: "
            'pip install "pyvista[jupyter]", or write .gif'
        )
