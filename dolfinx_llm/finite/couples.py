"""Couples on the frame's facets, where friction acts at some distance from them.

A curved frame stands out beyond its facets, so that node p touches it at d = x_p - sum_J N_pJ y_J
from where its row N puts the force tau on them: without more, forces on both sides would have the
moment tau x d. The corners c of the facet below bear that,

    f_c = w x r_c,   I w = d x tau,

with r_c their arms from their middle and I sum_c (r_c² 1 - r_c r_cᵀ): no resultant, and the moment.
It is what equation (19) has in Phi, the derivative of the base, for tangential forces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_I, _J, _K = np.indices((3, 3, 3))
ALTERNATING = {  # a x b, a number in the plane
    2: np.array([[[0.0, 1.0], [-1.0, 0.0]]]),
    3: (_J - _I) * (_K - _I) * (_K - _J) / 2.0,
}


@dataclass(frozen=True, eq=False)
class Couples:
    """Of k places on facets of c corners, with derivatives."""

    force: np.ndarray  # (k, c, gdim) on the corners [force]
    by_tau: np.ndarray  # (k, c gdim, gdim)
    by_height: np.ndarray  # (k, c gdim, 1) by d along the normal
    by_normal: np.ndarray  # (k, c gdim, gdim)
    by_y: np.ndarray  # (k, c gdim, c gdim) by the corners


def couples(tau: np.ndarray, height: np.ndarray, normal: np.ndarray, y: np.ndarray) -> Couples:
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
