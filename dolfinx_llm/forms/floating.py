"""Springs that hold free bodies while contact is being found, and what pulls at them."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from scipy.sparse import csr_matrix, identity
from scipy.sparse.linalg import splu

from dolfinx_llm.base.parallel import gather_rows
from dolfinx_llm.forms.verdict import UNBALANCED, FinalError
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.motions import rigid_motions
from dolfinx_llm.operators.numbering import Numbering
from dolfinx_llm.operators.petsc import times
from dolfinx_llm.operators.support import pins

SPRING = 1e-10  # stiffness of the springs that hold free bodies, of the surfaces'
WEAKER = 1e-5  # ... of that of springs which hold other bodies
LEAST = 1e-13  # ... of the surfaces', at least
PULLED = 8  # iterations in which the springs are pulled the same way: nothing else will hold
PLAIN = 1e-4  # of the forces, that they must carry for it while contact still changes
DRIFTS = 1e-9  # rounding of K over the stiffness of springs, from which on it is looked at
STEADY = 0.95  # part of the force of one iteration that is left in the next: it does not fall
NOTHING = 1e-12  # of the forces, that the springs may carry at a solution
ALIKE = 0.99  # cosine between forces that count as the same


class Floating:
    """Rigid motions that supports leave to the bodies, α, each held by a weak spring at one dof.

    The springs pull to where the bodies were. At a solution they carry nothing: what they carry
    else is the part of the load that neither supports nor contact take.

    Args:
        K, B: (31).
        rows: the multipliers' ``Numbering``.
        bodies: the bodies.
        fixed: (n_local,) prescribed dofs.
    """

    def __init__(self, K: Any, B: Any, rows: Numbering, bodies: Bodies, fixed: np.ndarray) -> None:
        self.comm, self.rigid = bodies.comm, rigid_motions(bodies, K, fixed)
        self.count = self.rigid.free
        self.modes = self.rigid.modes[:, : self.count]
        self.pins = pins(self.comm, self.modes)
        self._at_pins = gather_rows(self.comm, self.modes[self.pins])  # (count, count)
        self.square = self._at_pins.T @ self._at_pins
        own = np.zeros((rows.sizes[0], self.rigid.modes.shape[1]))
        for k, mode in enumerate(self.rigid.modes.T):
            own[:, k] = times(B, mode, transposed=True)
        self.G = gather_rows(self.comm, own)[rows.number]  # (n, k) Bᵀ of all rigid motions

    def at_pins(self, amounts: np.ndarray) -> np.ndarray:
        """Motion of this rank's pins for (count,) α [length]."""
        return self.modes[self.pins] @ amounts

    def amounts(self, u: np.ndarray) -> np.ndarray:
        """(count,) α of this rank's displacement u (n_local,)."""
        return np.linalg.solve(self._at_pins, gather_rows(self.comm, u[self.pins]))

    def spring(self, scale: float) -> float:
        """Stiffness of the springs [force / length]: weak against ``scale``, and against springs
        of the bodies' own that they may act in line with, as far as digits allow."""
        weakest = np.diagonal(self.rigid.stiffness)[self.count :].min(initial=np.inf)
        return float(max(min(SPRING * scale, WEAKER * weakest), LEAST * scale))

    @property
    def grip(self) -> np.ndarray:
        """(n, count) by how much multipliers may push along the free motions."""
        return np.abs(self.G[:, : self.count])

    def drift(self, L: csr_matrix) -> float:
        """Relative error of motions that weak springs alone hold: the stiffness of the bodies, with
        its rounding, stands beside theirs.

        Args:
            L: (n, m) rows of L_b in contact, the others zero.
        """
        rigid, weak = self.rigid, slice(self.count, None)
        own, noise = rigid.stiffness[weak, weak], np.diag(rigid.noise[weak])
        if not (np.diagonal(noise) > DRIFTS * np.diagonal(own)).any():
            return 0.0
        on = np.diff(L.indptr) > 0
        G = self.G[:, weak] * on[:, None]
        if L.shape[1]:
            fit = splu((L.T @ L + 1e-10 * identity(L.shape[1])).tocsc())
            G = G - L @ fit.solve(L.T @ G)
        values, vectors = np.linalg.eigh(G.T @ G)
        loose = vectors[:, values < 1e-8 * max(np.abs(self.G).max(initial=0.0), 1.0)]
        if not loose.shape[1]:
            return 0.0
        return float(scipy.linalg.eigh(loose.T @ noise @ loose, loose.T @ own @ loose)[0].max())

    def sizes(self, f: np.ndarray) -> np.ndarray:
        """(count,) this rank's loads f along the motions, summed up over all without sign."""
        return self.comm.allreduce(np.abs(self.modes).T @ np.abs(f))


class Pull:
    """What the springs carry from one iteration of a contact law to the next.

    Where contact holds the bodies it vanishes as soon as the state of contact stays. What stays
    then, or goes on for ``PULLED`` iterations, finds nothing that holds it: a mechanism.

    Args:
        floating: the motions.
        spring: stiffness of the springs [force / length].
        f: this rank's loads.
        forces: size of the forces in earlier load steps.
        start: (count,) where the springs hold the motions.

    Attributes:
        anchor: (count,) where they hold them next.
        share: of the forces along the motions, that they carried in the last iteration.
    """

    def __init__(
        self, floating: Floating, spring: float, f: np.ndarray, forces: float, start: np.ndarray
    ) -> None:
        self._floating, self._spring, self._loads = floating, spring, floating.sizes(f)
        self._forces, self.anchor, self.share = forces, start, 0.0
        self._last, self._pulls = np.zeros(floating.count), 0
        self._moved = np.zeros(floating.count)
        self._least = UNBALANCED  # share that may be rounding
        self._rest = np.inf  # last share while the state of contact stayed

    def watch(self, alpha: np.ndarray, multiplier: np.ndarray, calm: int, noise: float) -> None:
        """See another iteration.

        Args:
            alpha: (count,) where the motions went to.
            multiplier: (n,) λ.
            calm: iterations since the state of contact changed.
            noise: rounding of forces [force].

        Raises:
            FinalError: nothing holds some bodies.
        """
        if not self._floating.count:
            return
        moved = alpha - self.anchor
        force = self._spring * (self._floating.square @ moved)
        size = (self._loads + np.abs(multiplier) @ self._floating.grip).max()
        size = max(size, self._forces)
        self._rest = self.share if calm > 1 else np.inf
        self.share = float(np.abs(force).max() / size) if size > 0.0 else 0.0
        self._least = max(UNBALANCED, noise / size) if size > 0.0 else UNBALANCED
        lengths = np.linalg.norm(force), np.linalg.norm(self._last)
        same = force @ self._last > ALIKE * lengths[0] * lengths[1]
        same = same and lengths[0] > 0.1 * lengths[1] > 0.0
        stays = same and lengths[0] > STEADY * lengths[1]
        self._last, self._pulls = force, self._pulls + 1 if same and self.share > PLAIN else 0
        if self._pulls > PULLED or (calm > 1 and stays and self.share > self._least):
            raise FinalError(
                f"contact and supports do not balance the load: {self.share:.1e} of the forces "
                "is left. A body that only contact holds is pulled off, or slides or turns away "
                f"without end: {self._floating.rigid.describe(moved, force)}. Add supports or "
                "springs that hold it, prescribe its motion, or change the load"
            )
        if calm:
            self.anchor = self._next(moved, calm)
        self._moved = moved

    def _next(self, moved: np.ndarray, calm: int) -> np.ndarray:
        """Springs pull to where the bodies were until contact stays, so that a motion that contact
        leaves free is not one that some iteration has led to. Then they follow; where something
        nearly as weak holds the bodies, farther than these went (Aitken)."""
        before = self._moved @ self._moved
        rate = float(moved @ self._moved / before) if calm > 1 and before > 0.0 else 0.0
        far = self.share > self._least and 1e-3 < rate < STEADY
        return self.anchor + moved / (1.0 - rate if far else 1.0)

    @property
    def rests(self) -> bool:
        """Whether the springs carry nothing but rounding."""
        falls = self.share < 0.5 * self._rest
        return self.share <= NOTHING or (self.share <= self._least and not falls)
