"""The pieces of an interface joined to one: one frame, one set of pairs per side."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import block_diag, csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.loads import NodalLoads
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.geometry.pieces import Piece
from dolfinx_llm.geometry.surface import Surface


@dataclass(frozen=True)
class Certificate:
    """What can be said of an interface before any solve."""

    residual: float  # max |r| / max f, (28); of curved surfaces in space, or along their normals
    # where nothing else acts
    residual_before: float  # the same before design
    singular_values: tuple[float, float]  # smallest and largest of the scalar L_b
    linear: float  # max |sum_J N_J Y_J - X_p| in the plane, over the diameter
    largest_correction: float  # of an entry of L_b by design
    place: float = 0.0  # about how well curved surfaces are known between their nodes [length]


@dataclass(frozen=True, eq=False)
class Part:
    """What is built of one piece."""

    piece: Piece
    pairs: tuple[ContactPairs, ...]  # of both sides
    frame: Frame
    base: Array  # (m, gdim, gdim) tangents and normal, out of side 0, at the frame's nodes
    certificate: Certificate


def whole_piece(pieces: Sequence[Piece]) -> Piece:
    """All pieces as one, which no plane does for."""
    first, second = (np.sort(np.concatenate([piece.facets[k] for piece in pieces])) for k in (0, 1))
    return Piece((first, second), None, 0)


def joined(
    whole: Sequence[Surface], parts: Sequence[Part]
) -> tuple[tuple[ContactPairs, ...], Frame, Array, Certificate]:
    """One frame and pairs of both sides for all parts; nodes of several have a pair in each."""
    if len(parts) == 1:
        part = parts[0]
        return part.pairs, part.frame, part.base, part.certificate
    frames = [part.frame for part in parts]
    starts = np.cumsum([0] + [len(frame.x) for frame in frames])
    frame = Frame(
        np.concatenate([frame.x for frame in frames]),
        np.concatenate([frame.cells + start for frame, start in zip(frames, starts)]),
    )
    pairs = tuple(
        _joined_pairs(side, [part.pairs[k] for part in parts], frames)
        for k, side in enumerate(whole)
    )
    base = np.concatenate([part.base for part in parts])
    return pairs, frame, base, _worst([part.certificate for part in parts])


def _joined_pairs(
    whole: Surface, pairs: Sequence[ContactPairs], frames: Sequence[Frame]
) -> ContactPairs:
    """The pairs of one side, in the order of the surface's nodes."""
    dofs = np.concatenate([p.surface.dofs for p in pairs])
    facets = np.isin(whole.dofs, dofs)[whole.facets].all(axis=1)
    surface = whole.part(np.flatnonzero(facets))
    by_dof = np.argsort(surface.dofs)
    nodes = by_dof[
        np.searchsorted(surface.dofs, np.concatenate([p.dofs for p in pairs]), sorter=by_dof)
    ]
    order = np.argsort(nodes, kind="stable")
    cells = np.cumsum([0] + [len(frame.cells) for frame in frames])
    both = {
        name: np.concatenate([getattr(p, name) for p in pairs])[order]
        for name in ("normal", "base", "gap")
    }
    return replace(
        pairs[0],
        surface=surface,
        nodes=nodes[order],
        loads=NodalLoads.joined([p.loads for p in pairs]).of(order),
        cell=np.concatenate([p.cell + first for p, first in zip(pairs, cells)])[order],
        N=csr_matrix(block_diag([p.N for p in pairs], format="csr")[order]),
        **both,
    )


def _worst(certificates: Sequence[Certificate]) -> Certificate:
    """What can be said of all."""
    values = np.array([c.singular_values for c in certificates])
    return Certificate(
        max(c.residual for c in certificates),
        max(c.residual_before for c in certificates),
        (float(values[:, 0].min()), float(values[:, 1].max())),
        max(c.linear for c in certificates),
        max(c.largest_correction for c in certificates),
        max(c.place for c in certificates),
    )
