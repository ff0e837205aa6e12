"""Contact with friction on the moving frame, by Coulomb's law at the nodes of the moving side.

What node p touched at the start is sum_J N⁰_pJ y_J, with the frozen row N⁰ of its place on the
frame then; tau_p acts on the frame's node J by N_pJ tau_p, and by the couple that its arm from
there to p asks for. Rows are designed with t·(x_p - sum_J N_pJ y_J) = 0 for tangents t, so that
there is no slip at the start, and none when all turns. The chord is smooth where p slides over
several facets, in 3D as well.

A curved frame stands out beyond its facets, so that node p touches it at d = x_p - sum_J N_pJ y_J
from where its row N puts the force tau on them: without more, forces on both sides would have the
moment tau x d. The corners c of the facet below bear that,

    f_c = w x r_c,   I w = d x tau,

with r_c their arms from their middle and I sum_c (r_c² 1 - r_c r_cᵀ): no resultant, and the moment.
It is what equation (19) has in Phi, the derivative of the base, for tangential forces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.sparse import csr_matrix, hstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, per_component, per_item, summing
from dolfinx_llm.finite.frame.jacobians import coordinates
from dolfinx_llm.finite.frame.sides import HARDLY
from dolfinx_llm.finite.pairs.friction import Friction, tangential
from dolfinx_llm.finite.pairs.normal_contact import NormalContact, NormalPlace
from dolfinx_llm.finite.pairs.terms import ContactTerms
from dolfinx_llm.laws.rows import OPEN

_I, _J, _K = np.indices((3, 3, 3))
ALTERNATING = {  # a x b, a number in the plane
    2: np.array([[[0.0, 1.0], [-1.0, 0.0]]]),
    3: (_J - _I) * (_K - _I) * (_K - _J) / 2.0,
}


@dataclass(frozen=True, eq=False)
class Couples:
    """Of k places on facets of c corners, with derivatives."""

    force: Array  # (k, c, gdim) on the corners [force]
    by_tau: Array  # (k, c gdim, gdim)
    by_height: Array  # (k, c gdim, 1) by d along the normal
    by_normal: Array  # (k, c gdim, gdim)
    by_y: Array  # (k, c gdim, c gdim) by the corners


def couples(tau: Array, height: Array, normal: Array, y: Array) -> Couples:
    """The forces.

    Args:
        tau: (k, gdim) what acts on the frame [force].
        height: (k,) length of d, which is along the normal [length].
        normal: (k, gdim).
        y: (k, c, gdim) corners of the facets below [length].
    """
    k, c, gdim = y.shape
    eps = ALTERNATING[gdim]
    arm = y - y.mean(axis=1, keepdims=True)
    turn = np.einsum("sai,kca->kcis", eps, arm)  # forces of a unit of w
    inverse = np.linalg.inv(np.einsum("kcis,kcit->kst", turn, turn))
    d = height[:, None] * normal
    w = np.einsum("kst,tij,ki,kj->ks", inverse, eps, d, tau)
    force = np.einsum("kcis,ks->kci", turn, w)
    by_moment = turn.reshape(k, c * gdim, len(eps)) @ inverse
    by_d = by_moment @ np.einsum("sij,kj->ksi", eps, tau)
    # By the arms: of ``turn`` in the force, and of I in w.
    swing = np.einsum("sai,ks->kia", eps, w)  # change of a corner's force for one of its arm
    change = np.einsum("cb,kia->kciba", np.eye(c), swing)
    inertia = np.einsum("sai,kbi->ksba", eps, force)
    inertia += np.einsum("kbis,kia->ksba", turn, swing)
    change -= (by_moment @ inertia.reshape(k, len(eps), c * gdim)).reshape(change.shape)
    change -= change.mean(axis=3, keepdims=True)  # arms are from the middle
    return Couples(
        force=force,
        by_tau=by_moment @ np.einsum("sij,ki->ksj", eps, d),
        by_height=by_d @ normal[:, :, None],
        by_normal=by_d * height[:, None, None],
        by_y=change.reshape(k, c * gdim, c * gdim),
    )


@dataclass(frozen=True, eq=False)
class FrictionContact(Friction, NormalContact):
    """With friction at the nodes of the moving side."""

    cuts: ClassVar[bool] = False  # forces at nodes are within the cone about their own normals

    def supported(self, place: NormalPlace, closed: Array, way: csr_matrix, free: Array) -> Array:
        """Also those at supports of both sides: rows reach to nodes beside these, from where they
        tell next to nothing of what of the force is friction and what the supports'."""
        on_x, on_y = self.sides.split(free)
        at, C = place.at, self.sides.control[0]
        cells = self.sides.carrier.cells[at.facet]
        loose = ((np.abs(at.N) > HARDLY)[:, :, None] & on_y[cells]).any(axis=1) | on_x
        both = (abs(C)[closed] @ loose.astype(float)) == 0.0
        return both | super().supported(place, closed, way, free)

    def turned(self, place: NormalPlace, nodes: Array) -> csr_matrix:
        among = np.searchsorted(place.on, nodes)
        return place.turned[coordinates(among[:, None], self.sides.gdim).ravel()]

    def growth(self, place: NormalPlace, nodes: Array) -> csr_matrix:
        return place.grown[nodes]

    def along(self, q: Array, status: Array) -> Array:
        n, gdim = len(status), self.sides.gdim
        return np.where((status != OPEN)[:, None], tangential(q, n, gdim), 0.0)

    def dragged(self, t: ContactTerms, place: NormalPlace, tau: Array) -> ContactTerms:
        """Terms of what presses, with tau (n, gdim) as well, also as couples bear its arm; rows
        spread it with what presses."""
        t, on = super().dragged(t, place, tau), place.on
        (n, _, c), gdim, width = self.counts, self.sides.gdim, self.sides.width
        C = self.sides.control[0][:, on].T  # to these nodes
        at_nodes = C @ tau
        cells = self.sides.carrier.cells[place.at.facet[on]]
        y, height = self.sides.split(place.z)[1], -np.einsum("ks,ks->k", place.rows.N, place.height)
        couple = couples(at_nodes, height, place.normal[on], y[cells])
        at = coordinates(cells, gdim, self.sides.columns[1])
        _, height_z, height_mu = place.distance
        gather, by_height = summing(at.ravel(), width), per_item(couple.by_height)
        by_z = by_height @ height_z + per_item(couple.by_normal) @ place.turned
        by_z = by_z + per_item(couple.by_y) @ gather.T
        shut = diagonal((t.status != OPEN).astype(float))
        by_tau = per_item(couple.by_tau) @ per_component((C @ shut).tocsr(), gdim)
        force = gather @ couple.force.ravel()
        of_mu = gather @ by_height @ height_mu
        none = csr_matrix((width, n)), csr_matrix((width, c))
        top = hstack([none[0], of_mu, none[1], gather @ by_tau], format="csr")
        return replace(
            t,
            force=t.force + force,
            K=(t.K - gather @ by_z).tocsr(),
            top=t.top - top,
            friction=t.friction + force,
        )
