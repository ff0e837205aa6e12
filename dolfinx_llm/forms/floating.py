"""What pulls at the springs that hold free bodies while contact is being found."""

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.forms.verdict import EPS, SEVERAL, UNBALANCED, FinalError
from dolfinx_llm.operators.floating import Floating

PULLED = 8  # iterations in which the springs are pulled the same way: nothing else will hold
PLAIN = 1e-4  # of the forces, that they must carry for it while contact still changes
STEADY = 0.95  # part of the force of one iteration that is left in the next: it does not fall
NOTHING = 1e-12  # of the forces, that the springs may carry at a solution
ALIKE = 0.99  # cosine between forces that count as the same


class Pull:
    """What the springs carry from one iteration of a contact law to the next.

    Where contact holds the bodies it vanishes as soon as the state of contact stays. What stays
    then, or goes on for ``PULLED`` iterations, finds nothing that holds it: a mechanism.

    Args:
        floating: the motions.
        spring: stiffness of the springs [force / length].
        f: this rank's loads.
        before: rounding of forces, that the last load steps have left, and the size of forces with
            which the last one ended: next to nothing of these is none without loads [force].
        start: (count,) where the springs hold the motions.

    Attributes:
        anchor: (count,) where they hold them next.
        share: of the forces along the motions, that they carried in the last iteration.
        most: that they have carried in all, at most [force].
    """

    def __init__(
        self,
        floating: Floating,
        spring: float,
        f: Array,
        before: tuple[float, float],
        start: Array,
    ) -> None:
        self._floating, self._spring, self._loads = floating, spring, floating.sizes(f)
        self.anchor, self.share, self.most = start, 0.0, 0.0
        rounding, forces = before
        freed = self._loads.max(initial=0.0) <= SEVERAL * EPS * forces
        self._least_size = max(rounding / UNBALANCED, forces if freed else 0.0)  # or it is rounding
        self._last, self._pulls = np.zeros(floating.count), 0
        self._moved = np.zeros(floating.count)
        self._least = UNBALANCED  # share that may be rounding
        self._rest = np.inf  # last share while the state of contact stayed

    def watch(self, alpha: Array, multiplier: Array, calm: int, noise: float) -> None:
        """See another iteration: where the motions went to (count,), λ, iterations since the state
        of contact changed, rounding of forces. ``FinalError`` where nothing holds some bodies,
        ``ContactError`` where it may be for a few pairs that are told wrongly."""
        if not self._floating.count:
            return
        moved = alpha - self.anchor
        force = self._spring * (self._floating.square @ moved)
        self.most = max(self.most, float(np.abs(force).sum()))
        size = (self._loads + np.abs(multiplier) @ self._floating.grip).max()
        size = max(size, self._least_size)
        self._rest = self.share if calm > 1 else np.inf
        self.share = float(np.abs(force).max() / size) if size > 0.0 else 0.0
        self._least = max(UNBALANCED, noise / size) if size > 0.0 else UNBALANCED
        lengths = np.linalg.norm(force), np.linalg.norm(self._last)
        same = force @ self._last > ALIKE * lengths[0] * lengths[1]
        same = same and lengths[0] > 0.1 * lengths[1] > 0.0
        stays = same and lengths[0] > STEADY * lengths[1]
        self._last, self._pulls = force, self._pulls + 1 if same and self.share > PLAIN else 0
        if self._pulls > PULLED or (calm > 1 and stays and self.share > self._least):
            kind = FinalError if self.share > PLAIN else ContactError
            raise kind(out_of_balance(self._floating, self.share, moved, force))
        if calm:
            self.anchor = self._next(moved, calm)
        self._moved = moved

    def _next(self, moved: Array, calm: int) -> Array:
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


def out_of_balance(
    floating: Floating, share: float, motion: Array, force: Array, pushed: float = 0.0
) -> str:
    """Words for a share of the forces that nothing balances, and for the motion (count,) of the
    bodies that they drive, forces (count,) along their motions and the work ``pushed`` that those
    on obstacles do besides."""
    return (
        f"contact and supports do not balance the load: {share:.1e} of the forces is left. A body "
        "that only contact holds is pulled off, or slides or turns away without end: "
        f"{floating.rigid.describe(motion, force, pushed)}. Add supports or springs that hold it, "
        "prescribe its motion, or change the load"
    )
