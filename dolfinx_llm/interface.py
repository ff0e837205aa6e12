"""An interface between two surfaces: the user's choices and all that follows from geometry."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import identity
from scipy.spatial import cKDTree

from dolfinx_llm import compat
from dolfinx_llm._parallel import ContactError, ContactInputError
from dolfinx_llm.design import TOLERANCE, design_weights, patch_residual
from dolfinx_llm.frame import Frame, outside_distance, vector_areas
from dolfinx_llm.laws import Tied
from dolfinx_llm.pairs import ContactPairs, locate_pairs, rank_certificate, with_weights
from dolfinx_llm.patch import Plane, common_area, common_plane, covered_forces, nodal_forces
from dolfinx_llm.positions import design_positions
from dolfinx_llm.surface import Surface, check_sides, extract_surface

log = logging.getLogger("dolfinx_llm")

DESIGNS = ("auto", "positions", "weights", None)


@dataclass(frozen=True)
class Interface:
    """Two surfaces in contact. Neither side is preferred; their order does not matter.

    Args:
        facet_tags: dolfinx mesh tags of facets; unused where ``sides`` brings its own.
        sides: the two facet tags, e.g. (3, 7); or ((tags_0, 3), (tags_1, 7)) for two meshes.
        law: contact law, ``Tied()``.
        frame: contact frame; None: predicted from the two surfaces.
        design: how the frame is made to pass the patch test (28): "weights" corrects the rows of
            L_b, "positions" moves the frame's nodes (paper, section 5), None leaves it as it is,
            "auto" corrects weights where the frame does not pass already.

    Raises:
        ContactInputError: unknown design or law, or sides that are no pair.
    """

    facet_tags: object
    sides: tuple
    law: Tied = field(default_factory=Tied)
    frame: Frame | None = None
    design: str | None = "auto"

    def __post_init__(self):
        if self.design not in DESIGNS:
            raise ContactInputError(f"design={self.design!r}: choose one of {DESIGNS}")
        if not isinstance(self.law, Tied):
            raise ContactInputError(f"law={self.law!r}: choose Tied()")
        if self.frame is not None and not isinstance(self.frame, Frame):
            raise ContactInputError(f"frame={self.frame!r}: give a dolfinx_llm.Frame or None")
        try:
            n = len(self.sides)
        except TypeError:
            n = 0
        if n != 2:
            raise ContactInputError(f"sides={self.sides!r}: give two facet tags")

    def tagged_sides(self):
        """The two sides as (facet tags, tag)."""
        return [
            side if isinstance(side, (tuple, list)) else (self.facet_tags, side)
            for side in self.sides
        ]


@dataclass(frozen=True)
class Certificate:
    """What can be said of an interface before any solve."""

    residual: float  # max |r| / max f, (28)
    residual_before: float  # the same before design
    singular_values: tuple[float, float]  # smallest and largest of the scalar L_b
    linear: float  # max |sum_J N_J Y_J - X_p| in the plane, over the diameter
    largest_correction: float  # of an entry of L_b by design
    beyond: float  # how far pairs lie beyond the frame's outline, in cells


@dataclass(frozen=True)
class ContactModel:
    """An interface, ready for assembly; the same on every rank."""

    interface: Interface
    sides: tuple[Surface, Surface]
    spaces: tuple[int, int]  # index of the function space of each side
    pairs: tuple[ContactPairs, ContactPairs]
    frame: Frame
    directions: np.ndarray  # (m, d, gdim) directions in which the frame's nodes move
    area: float  # of contact [area]
    certificate: Certificate
    notes: tuple[str, ...]  # what was chosen or left out, and why
    times: dict  # seconds per stage


class _Clock:
    """Seconds of stages that follow each other."""

    def __init__(self):
        self.times, self._last = {}, time.perf_counter()

    def stop(self, stage: str):
        now = time.perf_counter()
        self.times[stage] = self.times.get(stage, 0.0) + now - self._last
        self._last = now


def build_model(interface: Interface, spaces) -> ContactModel:
    """Surfaces, common area, frame, design and pairs of an interface.

    Collective. Everything after the gathering of the surfaces is computed alike on all ranks.

    Raises:
        ContactError, ContactInputError: see the functions called.
    """
    clock = _Clock()
    owners = [_space_of(tags, spaces) for tags, _ in interface.tagged_sides()]
    sides = tuple(
        extract_surface(spaces[i], tags, tag)
        for i, (tags, tag) in zip(owners, interface.tagged_sides())
    )
    check_sides(*sides, same_mesh=owners[0] == owners[1])
    clock.stop("surfaces")
    plane = common_plane(*sides)
    _check_flat(sides, plane)
    area = common_area(*sides, plane)
    forces = [nodal_forces(side, plane.project(side.x), area) for side in sides]
    clock.stop("patch forces")
    frame, notes, reach = _frame(interface, sides, forces, plane)
    clock.stop("frame")
    if interface.design == "positions":
        in_contact = [f > 0.0 for f in forces]
        frame = design_positions(
            frame,
            [side.x[k] for side, k in zip(sides, in_contact)],
            [f[k] for f, k in zip(forces, in_contact)],
        )
        notes.append("design: frame nodes moved (positions)")
        clock.stop("design")
    pairs = [
        locate_pairs(side, f, frame, sign, reach, local_base=False)
        for side, f, sign in zip(sides, forces, (1.0, -1.0))
    ]
    clock.stop("location")
    pairs, certificate = _designed(interface, frame, plane, pairs, notes)
    clock.stop("design")
    directions = np.broadcast_to(np.eye(frame.gdim), (len(frame.x), frame.gdim, frame.gdim))
    total = float(sum(pairs[0].forces))
    log.info("interface %s: %s", interface.sides, certificate)
    return ContactModel(
        interface, sides, tuple(owners), tuple(pairs), frame, directions, total, certificate,
        tuple(notes), clock.times,
    )  # fmt: skip


def _space_of(tags, spaces) -> int:
    """Index of the function space whose mesh the tags mark."""
    if len(spaces) == 1:
        return 0
    for i, V in enumerate(spaces):
        if compat.tags_belong_to(tags, V.mesh):
            return i
    raise ContactInputError(
        "the facet tags belong to none of the meshes of the forms. For bodies on two meshes give "
        "sides=((tags_0, tag_0), (tags_1, tag_1))"
    )


def _check_flat(sides, plane: Plane) -> None:
    """Require flat sides, parallel to each other."""
    size = max(side.diameter for side in sides)
    for side in sides:
        height = plane.height(side.x)
        bow = np.ptp(height)
        if bow > 1e-6 * size:
            raise ContactError(
                f"{side.name} is not flat, or the sides are not parallel: its nodes lie within "
                f"{bow:.3g} along the normal {plane.normal.round(6).tolist()} (allowed "
                f"{1e-6 * size:.3g}); curved interfaces are not supported yet"
            )


def _frame(interface: Interface, sides, forces, plane: Plane):
    """The user's frame, turned to point out of side 0, or a predicted one."""
    notes = []
    if interface.frame is not None:
        frame = interface.frame
        if frame.gdim != len(plane.origin):
            raise ContactInputError(
                f"the frame lies in {frame.gdim}D, the bodies in {len(plane.origin)}D"
            )
        if vector_areas(frame.x, frame.cells).sum(axis=0) @ plane.normal < 0.0:
            frame = frame.flipped()
        return frame, ["frame: given"], 1e-6
    frame, note = predict_frame(sides, forces, plane)
    return frame, [note], 3.0


def predict_frame(sides, forces, plane: Plane) -> tuple[Frame, str]:
    """Frame for two flat surfaces: the facets in contact of the coarser side, on the mid-plane.

    Its nodes are then nodes of that side, so that L_b has full column rank whatever the other side
    looks like, and it is as dense as the coarser side.

    Args:
        sides: the two surfaces.
        forces: pair of (n_i,) forces of unit pressure.
        plane: contact plane.

    Returns:
        The frame and a sentence that says what it is.
    """
    touched = []
    for side, f in zip(sides, forces):
        # A facet counts if all its nodes carry force: those that the area merely borders do not.
        facets = side.facets[(f[side.facets] > 0.0).all(axis=1)]
        size = np.linalg.norm(vector_areas(side.x, facets), axis=1).mean()
        touched.append((facets, size))
    sizes = [size for _, size in touched]
    if abs(sizes[0] - sizes[1]) > 1e-9 * max(sizes):
        k = int(np.argmax(sizes))
    else:  # equally coarse: what does not depend on the order of the sides decides
        keys = [(-len(facets), tuple(side.x[facets].sum(axis=(0, 1)))) for side, (facets, _) in
                zip(sides, touched)]  # fmt: skip
        k = 0 if keys[0] <= keys[1] else 1
    facets = touched[k][0]
    nodes, cells = np.unique(facets, return_inverse=True)
    x = sides[k].x[nodes]
    heights = [plane.height(side.x).mean() for side in sides]
    x = x + np.outer(np.mean(heights) - plane.height(x), plane.normal)
    frame = Frame(x, cells.reshape(facets.shape))
    if vector_areas(frame.x, frame.cells).sum(axis=0) @ plane.normal < 0.0:
        frame = frame.flipped()
    note = f"frame: predicted, the {len(cells.reshape(facets.shape))} facets in contact of the coarser side ({sides[k].name})"
    return frame, note


def _designed(interface: Interface, frame: Frame, plane: Plane, pairs, notes: list):
    """Pairs after design by weights where it is asked for or needed, and their certificate."""
    forces = [p.forces for p in pairs]
    plain = [p.N for p in pairs]
    before = float(np.abs(patch_residual(plain, forces)).max())
    N = plain
    if interface.design == "weights" or (interface.design == "auto" and before > TOLERANCE):
        s = plane.project(frame.x)
        N = design_weights(frame, s, plain, [p.cell for p in pairs], forces)
        pairs = [with_weights(p, M, frame) for p, M in zip(pairs, N)]
        notes.append("design: rows of L_b corrected (weights)")
    elif interface.design == "auto":
        notes.append("design: left out, the frame passes as it is")
    elif interface.design is None:
        notes.append(f"design: none, as asked; patch residual {before:.1e}")
    residual = float(np.abs(patch_residual(N, forces)).max())
    singular = rank_certificate(frame, N)
    size = max(p.surface.diameter for p in pairs)
    linear = max(np.abs(plane.project(p.x) - plane.project(p.x - p.gap)).max() for p in pairs)
    change = max(np.abs(a - b).max() for a, b in zip(N, plain))
    return pairs, Certificate(residual, before, singular, float(linear / size), float(change), 0.0)
