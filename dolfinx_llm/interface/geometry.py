"""An interface ready for assembly: the outcome of ``build``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.certificate import Certificate
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.interface.join import Part
from dolfinx_llm.interface.site import Site


@dataclass(frozen=True, eq=False)
class ContactModel:
    """An interface, ready for assembly; the same on every rank."""

    interface: Interface  # the user's choices
    sides: tuple[Surface, ...]  # two; one against a rigid obstacle
    spaces: tuple[int, ...]  # index of the function space of each side
    pairs: tuple[ContactPairs, ...]  # of each side
    frame: Frame | None  # None against a rigid obstacle
    directions: np.ndarray  # (m, d, gdim) in which the frame's nodes move, or an obstacle (m = 1)
    # under a prescribed force
    area: float  # of contact, for laws that let bodies part the area where they may touch [area]
    certificate: Certificate | None  # None against a rigid obstacle
    rims: tuple[np.ndarray, ...]  # per side (n,) pairs next to facets that were left out
    notes: tuple[str, ...]  # what was chosen or left out, and why
    times: dict[str, float]  # seconds per stage
    site: Site  # what it was built of
    parts: tuple[Part, ...]  # its pieces, one after the other in frame and pairs; none against an
    # obstacle
    forced: tuple[bool, ...] = ()  # per component whether a force on the obstacle is prescribed

    @property
    def places(self) -> np.ndarray:
        """(m, gdim) where the unknowns of ``directions`` are: the frame's nodes; of an obstacle
        under force the middle of what may touch it."""
        if self.frame is not None:
            return self.frame.x
        return self.pairs[0].x.mean(axis=0)[None][: len(self.directions)]

    @cached_property
    def opposite(self) -> tuple[csr_matrix, ...]:
        """Per side (n, n_other) values of the other side's nodes at the point of its facets, as
        drawn, that is closest to each node; empty against a rigid obstacle."""
        found = []
        for own, other in zip(self.pairs, self.pairs[::-1] if len(self.pairs) == 2 else ()):
            x, facets = other.x, other.facets
            used, cells = np.unique(facets, return_inverse=True)
            at = Frame(x[used], cells.reshape(facets.shape)).locate(own.x)
            N = np.maximum(at.N, 0.0)  # beyond the rim the nearest point of it counts
            N /= N.sum(axis=1, keepdims=True)
            nodes, shape = facets[at.cell], (len(own.x), len(x))
            row = np.repeat(np.arange(len(own.x)), nodes.shape[1])
            found.append(csr_matrix((N.ravel(), (row, nodes.ravel())), shape))
        return tuple(found)
