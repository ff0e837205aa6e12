"""How problems show themselves: pictures, and text in notebooks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from dolfinx.fem import Function
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinx_llm.base import checks
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.parallel import collective


class Pictured:
    """A problem that shows itself and its last solve.

    Attributes:
        suited_scale: factor on displacements where none is given; None: such that they are seen.
    """

    suited_scale: float | None = None
    comm: MPI.Comm
    results: Any
    u: Any

    def _repr_html_(self) -> str:
        """For notebooks: what ``print`` says."""
        return f"<pre>{escape(str(self))}</pre>"

    def plot(
        self,
        folder: str | Path,
        field: str = "pressure",
        *,
        colour: str | Callable[[Function], Expr] = "pressure",
        scale: float | None = None,
        section: Sequence[Any] | None = None,
    ) -> None:
        """Pictures of the last solve as PNG, without a display: bodies.png, the deformed bodies of
        all meshes, and interface_0.png ... by a field of ``plot.interface``. Collective.

        Args:
            folder: where the pictures go; it is made.
            field: "pressure", "status" or "traction".
            colour: of bodies.png: "pressure" or "status" of the surfaces in contact, in translucent
                bodies, "displacement", its length, or a function of a mesh's displacement that
                returns a scalar UFL expression.
            scale: factor on the displacement; None: such that it can be seen, 1 at finite
                deformation.
            section: (point, normal) of a plane in 3D: cells in front of it are left out.

        Raises:
            ContactInputError: no such field, or a folder that cannot be made or written; on all
                ranks.
            ContactError: nothing has been solved, or after ``destroy``.
        """
        from dolfinx_llm.output.bodies import checked_view
        from dolfinx_llm.output.plot import FIELDS, draw_interface, draw_seen
        from dolfinx_llm.output.values import displacements
        from dolfinx_llm.output.writing import writable_folder

        if not self.results:
            raise ContactError("there is nothing to draw yet: call solve() first")
        motions = displacements(self.u)
        with collective(self.comm):
            checks.one_of("field", field, FIELDS)
            gdim = motions[0].function_space.mesh.geometry.dim
            scale = self.suited_scale if scale is None else scale
            view = checked_view(colour, scale, section, gdim)
            place = writable_folder("folder", folder)
        draw_seen(self.comm, view.seen(self.comm, motions, self.results), place / "bodies.png")
        with collective(self.comm):
            for i, result in enumerate(self.results if self.comm.rank == 0 else []):
                draw_interface(result, place / f"interface_{i}.png", field)
