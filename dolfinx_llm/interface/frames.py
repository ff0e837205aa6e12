"""The frame of an interface: the user's own, in closed form, predicted, or moved to pass."""

from collections.abc import Sequence
from typing import Any

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.log import log
from dolfinx_llm.design.line import frame_at_roots
from dolfinx_llm.design.predict import face_side_1, predict_frame
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.overlap_flat import Plane
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.site import Site

# Cells that a node may lie beyond a frame's outline: a given one's, flat or along curved surfaces,
# and a predicted one's, where facets of the other side, in contact by a corner, may reach far.
COVERED, REACH, REACH_OF_PREDICTED = 1e-6, 3.0, 10.0


def choose_frame(
    site: Site,
    sides: tuple[Surface, ...],
    touched: Sequence[Array],
    plane: Plane | None,
    area: Any,
    corners: int | None,
) -> tuple[Frame, str, float]:
    """The user's frame, turned to point out of side 0, or a predicted one; a sentence that says
    what it is, and how many cells a node may lie beyond its outline.

    Args:
        site: of the interface.
        sides: the two surfaces of a piece.
        touched: pair of (n_i,) whether nodes belong to facets in contact.
        plane: of flat surfaces; None: they are curved.
        area: what both cover, in the plane.
        corners: of a predicted frame's cells; None: those of the coarser side.
    """
    interface = site.interface
    carrier = site.carrier if site.prescribed is None else site.prescribed
    if interface.frame is not None:
        frame = face_side_1(interface.frame, sides[0])
        if plane is None:
            if frame.element.order > 1:
                raise ContactInputError(
                    "the given frame has straight cells of second order, the surfaces are curved: "
                    "give cells of first order, or frame=None for the facets of the coarser side"
                )
            return frame, "frame: given", REACH
        if frame.gdim == 2 and interface.design == "positions":
            return *frame_at_roots(sides, plane, area, frame), COVERED
        return frame, "frame: given", COVERED
    order = common_order(site, sides)
    if (
        order == 1
        and carrier is None
        and plane
        and len(plane.origin) == 2
        and interface.design in ("positions", "auto")
    ):
        try:
            return *frame_at_roots(sides, plane, area), COVERED
        except ContactError as error:
            if interface.design == "positions":
                raise
            log.info("closed form of the frame left out: %s", error)
    frame, note = predict_frame(sides, touched, plane, interface.law.opens, corners, order, carrier)
    return frame, note, REACH_OF_PREDICTED


def common_order(site: Site, sides: Sequence[Surface]) -> int:
    """Order of the fields that pass: the lower one of both sides, and of a given frame; that of a
    side that supports move as a whole, whose motion the frame has."""
    frame, orders = site.interface.frame, [side.element.order for side in sides]
    if site.prescribed is not None:
        return orders[site.prescribed]
    return min(orders if frame is None else [*orders, frame.element.order])


def move_nodes(frame: Frame, sides: Sequence[Surface], forces: Sequence[Array]) -> Frame:
    """The frame with its nodes moved."""
    from dolfinx_llm.design.positions import design_positions  # which few frames need

    in_contact = [f > 0.0 for f in forces]
    x = [side.x[k] for side, k in zip(sides, in_contact)]
    return design_positions(frame, x, [f[k] for f, k in zip(forces, in_contact)])
