"""What a law is told of the nodes at which it holds, and its linearised rows there.

A law holds at k nodes: those of the frame, or the surface's own against a rigid obstacle; with
friction along curved surfaces, and at finite deformation, those of the finer side. It is told
forces and jumps there, both of q components: along the tangents where the law ``slips``, then along
the normal where it ``gives``. Plain NumPy, so that a few nodes suffice to test it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError

OPEN, STICK, SLIP = 0, 1, 2
CLOSED = 3  # in contact, without friction
UNBOUNDED = 1e30  # trust in slips of an iterate, however far they go
LARGE = 1e3  # times the bodies' stiffness: rows with larger coefficients of jumps are divided


def value_now(name: str, value: Any, accepted: str) -> Any:
    """What a user gives for a law: a number, an array, a function of positions or a dolfinx
    Function; of a Constant its value now.

    Args:
        name, value, accepted: for the message.

    Raises:
        ContactInputError: a UFL expression, which is none of these, though it can be called, or a
            Function of complex values.
    """
    if np.iscomplexobj(getattr(getattr(value, "x", None), "array", 0.0)):
        checks.refuse(name, value, f"{accepted}; the Function has complex values: give real ones")
    if not hasattr(value, "ufl_shape") or hasattr(value, "function_space"):
        return value
    if np.ndim(getattr(value, "value", ())):
        checks.refuse(name, value, f"{accepted}; interpolate a UFL expression into a Function")
    return value.value


def at_positions(value: Any, x: Array) -> Array:
    """(k,) of a number, a Constant, an array or a function of positions.

    Raises:
        ContactInputError: what is given, or returned, are no real numbers.
    """
    value = value_now("a value at positions", value, "give a number, an array or a function")
    found = np.asarray(value(x) if callable(value) else value)
    if found.dtype.kind not in "iuf":
        raise ContactInputError(
            f"a law's value at {len(x)} positions is {checks.shown(found)}, of type {found.dtype}: "
            "give real numbers"
        )
    return np.full(len(x), float(found)) if not found.ndim else found.astype(np.float64)


@dataclass(frozen=True, eq=False)
class LawNodes:
    """What a law is told of the k nodes at which it holds.

    Forces are those that side 0 exerts on side 1 (a body on an obstacle), jumps the motion of side
    0 against side 1 since the drawing: positive normal ones are an overlap. Where the law lets
    pairs part and none is held, the normal jump is at least 0 here: what is apart carries no force.
    """

    x: Array  # (k, gdim) positions, as drawn [length]
    area: Array  # (k,) tributary area, in 2D by the thickness; as it is now [area]
    force: Array  # (k, q) [force]
    N: Array  # (k,) normal force, positive in compression [force]
    jump: Array  # (k, q) [length]
    before: Array  # (k, q) the jump at the end of the last load step [length]
    c: Array  # (k,) stiffness that the bodies set against jumps, about [force / length]
    status: Array  # (k,) in the last iterate: OPEN, STICK, SLIP, CLOSED
    history: dict[str, Array] = field(default_factory=dict)  # (k, ...) what the law keeps
    shared: csr_matrix | None = None  # (k, k) sums over the nodes for which each speaks; None: one
    sample: Callable[[Any], Array] | None = None  # (k,) of what users give
    given: dict[str, Array] = field(default_factory=dict)  # (k, ...) what ``begin_step`` has read
    trust: float = UNBOUNDED  # in slips of the last iterate, see ``newton_rows``

    @property
    def slip(self) -> Array:
        """(k, q) jump of this load step [length]."""
        return self.jump - self.before

    def sums(self, values: Array) -> Array:
        """(k,) sums over the nodes for which a node speaks.

        Args:
            values: (k,) at the nodes.
        """
        return values if self.shared is None else np.asarray(self.shared @ values)

    def values(self, value: Any) -> Array:
        """(k,) at the nodes of what a user gives for a law; collective.

        Args:
            value: a number, an array with an entry per node, a function of positions (k, gdim)
                that returns (k,), or a scalar dolfinx Function of one of the bodies' meshes.
        """
        if self.sample is not None:
            return self.sample(value)
        return at_positions(value, self.x)


@dataclass(frozen=True, eq=False)
class LawRows:
    """C_T T + C_jump δ + C_N S = rhs at k nodes, with forces T, jumps δ of the load step, and S the
    sum of weight N over the nodes for which a node speaks."""

    status: Array  # (k,) OPEN, STICK, SLIP, CLOSED
    C_T: Array  # (k, q, q)
    C_jump: Array  # (k, q, q) [force / length]
    C_N: Array  # (k, q)
    rhs: Array  # (k, q) [force]
    weight: Array | None = None  # (k,) None: 1
    # (k,) where pairs may pull, too; None: nowhere. It should follow from the history alone, which
    # stays within a load step.
    holds: Array | None = None

    @staticmethod
    def springs(
        nodes: LawNodes,
        force: Array,
        stiffness: Array,
        status: Array | None = None,
        holds: Array | None = None,
    ) -> LawRows:
        """A law that tells forces from jumps: T = force + stiffness (jump - the last jump).

        Args:
            nodes: with the last jump.
            force: (k, q) of the law there [force].
            stiffness: (k, q, q) its derivative by the jump, or (k, q) of each component by its own
                jump [force / length].
            status: (k,) of the nodes; None: they stick where the law slips, else they are closed.
            holds: (k,) where pairs may pull, too; None: nowhere.
        """
        k, q = nodes.jump.shape
        if np.ndim(stiffness) == 2:
            stiffness = np.asarray(stiffness)[:, :, None] * np.eye(q)
        given = force - np.einsum("nij,nj->ni", stiffness, nodes.slip)
        unit = np.broadcast_to(np.eye(q), (k, q, q))
        status = np.full(k, CLOSED if q == 1 else STICK) if status is None else status
        return LawRows(status, unit, -stiffness, np.zeros((k, q)), given, holds=holds)

    @staticmethod
    def layer(
        nodes: LawNodes,
        jump: Array,
        compliance: Array,
        status: Array | None = None,
        holds: Array | None = None,
    ) -> LawRows:
        """A law that tells jumps from forces: jump = that of the law + compliance (T - the last T).

        Args:
            nodes: with the last force.
            jump: (k, q) of the law there; where the last N pulls, as iterates may, go on along the
                tangent, or Newton's iteration loses its rate [length].
            compliance: (k, q) its derivative, component by component; 0: rigid [length / force].
            status, holds: (k,) as of ``springs``.
        """
        rigid = compliance <= 0.0
        stiff = np.where(rigid, nodes.c[:, None], 1.0 / np.where(rigid, 1.0, compliance))
        force = np.where(rigid, 0.0, nodes.force) - stiff * (jump - nodes.before)
        rows = LawRows.springs(replace(nodes, jump=nodes.before), force, stiff, status, holds)
        return replace(rows, C_T=np.where(rigid[:, :, None], 0.0, rows.C_T))

    def left(self, nodes: LawNodes) -> Array:
        """(k, q) what forces and jumps leave of the rows' balance [force].

        Args:
            nodes: with forces and jumps.
        """
        own = np.einsum("nij,nj->ni", self.C_T, nodes.force)
        own += np.einsum("nij,nj->ni", self.C_jump, nodes.slip)
        return own - self.lagged(nodes).rhs

    def lagged(self, nodes: LawNodes) -> LawRows:
        """The same with S of the last iterate, as for a known bound of friction.

        Args:
            nodes: with normal forces.
        """
        S = nodes.sums(nodes.N if self.weight is None else self.weight * nodes.N)
        return replace(self, C_N=np.zeros_like(self.C_N), rhs=self.rhs - self.C_N * S[:, None])

    def scaled(self, c: Array) -> LawRows:
        """The same equations, without rows of 1e11 times the others' size, among which a
        factorisation sees neither those nor that they are unsymmetric.

        Args:
            c: (k,) size that rows have [force / length].
        """
        size = np.abs(self.C_jump).max(axis=(1, 2), initial=0.0) / c
        by = 1.0 / np.where(size > LARGE, size, 1.0)[:, None]
        return replace(
            self,
            C_T=by[:, None] * self.C_T,
            C_jump=by[:, None] * self.C_jump,
            C_N=by * self.C_N,
            rhs=by * self.rhs,
        )

    def tied(self, speaker: Array, unheld: Array, c: float) -> LawRows:
        """The same, but that nodes for which others speak slip as those do: their δ, taken relative
        to it, vanishes; and that nodes which no force reaches do not slip.

        Args:
            speaker: (k,) of ``Followers``.
            unheld: (k,) of the function of that name.
            c: size of their rows [force / length].
        """
        own = speaker == np.arange(len(speaker))
        kept = (own & ~unheld)[:, None, None]
        unit = np.eye(self.rhs.shape[1])
        return replace(
            self,
            status=np.where(unheld, OPEN, self.status[speaker]),
            C_T=np.where(kept, self.C_T, 0.0),
            C_jump=np.where(kept, self.C_jump, c * unit),
            C_N=np.where(kept[:, 0], self.C_N, 0.0),
            rhs=np.where(kept[:, 0], self.rhs, 0.0),
        )
