"""Load steps as a film."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from dolfinx_llm.base import checks
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.output.bodies import Seen, checked_view, suited_scale
from dolfinx_llm.output.drawing import draw_scene
from dolfinx_llm.output.values import check_problem, displacements
from dolfinx_llm.output.writing import writable_file, writing


class Film:
    """An animated GIF of a problem's load steps, with one scale and one range of colours; drawn
    when it is closed. All calls are collective.

    Args:
        problem: the ``ContactProblem``, or the ``NonlinearContactProblem``.
        path: GIF to write.
        colour, scale, section: as of ``ContactProblem.plot``.
        seconds: for which a step is shown [s].

    Raises:
        ContactInputError: arguments of other types, or a path that cannot be written.

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
            self._path = writable_file("path", path, (".gif",))
            self._seconds = checks.number("seconds", seconds, "give a number of seconds")
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
        """Draw what was added; leaving a ``with`` block does so, too. May be called again."""
        seen, self._seen = self._seen, []
        with collective(self._problem.comm):
            self._draw([one for one in seen if one is not None])

    def _draw(self, seen: list[Seen]) -> None:
        """Write the film of what this rank has."""
        if not seen:
            return
        from PIL import Image  # which Matplotlib needs

        scale = min(suited_scale(one.skins) for one in seen)
        scenes = [one.scene(scale if self._view.scale is None else None) for one in seen]
        limits = min(s.limits[0] for s in scenes), max(s.limits[1] for s in scenes)
        with TemporaryDirectory() as folder:
            files = [Path(folder) / f"{i}.png" for i in range(len(scenes))]
            for scene, file in zip(scenes, files):
                draw_scene(replace(scene, limits=limits), file)
            first, *others = (Image.open(file).convert("RGB") for file in files)
            others = [image.resize(first.size) for image in others]
            with writing(self._path):
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
