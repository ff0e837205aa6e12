"""Coulomb's law at the frame's nodes: linearised rows for stick, slip and open.

The paper's (13) says that both bodies slip by the same κ about the frame. Node by node on two
meshes that do not match it cannot hold; read on the frame it can: κ is a field of the frame, the
nodes of both sides follow v + κ and v - κ. Per frame node J, with the tangential force T of side 0
on the frame, the normal force N and the slip δ = 2 (κ - κ_before) of this load step,

    |T| <= μ N;   |T| < μ N: δ = 0;   else T = μ N δ / |δ|.

Against a rigid obstacle, and along curved surfaces, where the other side carries the frame, each
node of a side is its own J and δ = κ - κ_before. Plain NumPy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.rows import OPEN, SLIP, STICK, UNBOUNDED, LawNodes, LawRows, value_now

AT_LEAST_0 = "give a finite number of at least 0"
METHODS = ("newton", "switch")
NO_PRESSURE = 1e-8  # of the largest normal force, up to which a node does not press
AT_LIMIT = 1e-10  # relative: so near to the limit what has slipped slips, what has stuck sticks
Varying = float | Array | Callable[[Array], Array]  # or a dolfinx Function


@dataclass(frozen=True, eq=False, repr=False)
class Coulomb(Law):
    """The bodies may part, stick, and slip under friction, (11)-(17).

    Args:
        mu: coefficient of friction, at least 0; 0 leaves out all that friction needs. A number, a
            function of positions (n, gdim) that returns (n,), a scalar dolfinx Constant, a scalar
            Function of one of the bodies' meshes, at nodes the mean of the cells with a facet
            there where it jumps, or an array with a value per node of ``result.x``: the frame's,
            or the surface's own against a rigid obstacle. All but numbers may change, and are
            read anew at the start of every load step.
        cohesion: tangential traction that the surfaces bear besides, where they are in contact,
            |T| <= μ N + cohesion area; given in the same ways [force / area].
        method: "newton": semismooth Newton on the projection form; "switch": the paper's own
            switch between stick and slip with the direction of the last iterate (16), (17), which
            settles gross sliding, and does not settle first slip where directions turn.
        dynamic: coefficient where the surfaces slide, at most mu, which then holds where they are
            at rest; given in the same ways; None: mu. What slips at the end of a load step or step
            in time has it from the next one on, until it comes to rest.

    Raises:
        ContactInputError: mu negative or not finite, unknown method, dynamic above mu.

    >>> Coulomb(0.3)
    Coulomb(mu=0.3, method='newton')
    >>> Coulomb(0.0).slips
    False
    """

    mu: Varying
    method: str = "newton"
    cohesion: Varying = 0.0
    dynamic: Varying | None = None
    slips: bool = field(init=False, default=True)  # whether there are tangential forces at all
    components: str = field(init=False, default="local")  # normal ones alone without friction
    shares = True

    @property
    def _bounds(self) -> dict[str, Varying]:
        """What is given, of Constants the values now."""
        given: dict[str, Any] = {"mu": self.mu, "cohesion": self.cohesion}
        if self.dynamic is not None:
            given["dynamic"] = self.dynamic
        return {k: value_now(f"Coulomb: {k}", value, AT_LEAST_0) for k, value in given.items()}

    def __post_init__(self) -> None:
        for name, value in self._bounds.items():
            if isinstance(value, np.ndarray) and value.ndim:
                _at_least_0(name, value, len(value))
            elif not callable(value):
                checks.number(f"Coulomb: {name}", value, AT_LEAST_0, low=0.0)
        checks.one_of("Coulomb: method", self.method, METHODS)
        given = self.mu, self.cohesion, 0.0 if self.dynamic is None else self.dynamic
        # What may change from one load step to the next bears, whatever it is now.
        bears = any(callable(a) or np.ndim(a) or a > 0.0 for a in given)
        object.__setattr__(self, "slips", bears)
        object.__setattr__(self, "components", "local" if bears else "normal")

    def __repr__(self) -> str:
        shown = [f"mu={checks.shown(self.mu)}", f"method={self.method!r}"]
        if callable(self.cohesion) or np.any(np.asarray(self.cohesion) != 0.0):
            shown.append(f"cohesion={checks.shown(self.cohesion)}")
        if self.dynamic is not None:
            shown.append(f"dynamic={checks.shown(self.dynamic)}")
        return f"Coulomb({', '.join(shown)})"

    def start(self, nodes: LawNodes) -> dict[str, Array]:
        """Which nodes slide: 1, and 0 at rest.

        Args:
            nodes: at rest.
        """
        return {"slides": np.zeros(len(nodes.x))}

    def begin_step(self, nodes: LawNodes) -> dict[str, Array]:
        """μ at rest and where nodes slide, and the forces of cohesion [force].

        Args:
            nodes: see ``Law``.

        Raises:
            ContactInputError: not a value of at least 0 for each, dynamic above mu.
        """
        n = len(nodes.x)
        found = {
            name: _at_least_0(name, nodes.values(value), n) for name, value in self._bounds.items()
        }
        dynamic = found.get("dynamic", found["mu"])
        above = dynamic - found["mu"]
        if (above > 0.0).any():
            raise ContactInputError(
                f"Coulomb: dynamic is above mu, by {above.max():g}: what slips would be at rest at "
                "once. Give a coefficient of at most mu"
            )
        return {"mu": found["mu"], "dynamic": dynamic, "cohesive": nodes.area * found["cohesion"]}

    def end_step(self, nodes: LawNodes) -> dict[str, Array]:
        return nodes.history | {"slides": (nodes.status == SLIP).astype(float)}

    @staticmethod
    def coefficient(nodes: LawNodes) -> Array:
        """(k,) of friction in this load step; between that at rest and the dynamic one where some
        of the nodes have slid from which a state was carried over.

        Args:
            nodes: with what has been read, and what the law keeps.
        """
        mu, dynamic = nodes.given["mu"], nodes.given["dynamic"]
        return mu + nodes.history["slides"] * (dynamic - mu)

    def _bound(self, nodes: LawNodes) -> Array:
        """(k,) what tangential forces may reach, node by node [force]. One that is pulled at, by a
        corrected row, bears nothing, and is missing where others are pressed by more for it: it
        takes from those that share with it, so that friction in all is at most μ N in all."""
        return self.coefficient(nodes) * nodes.N + self._cohesive(nodes)

    @staticmethod
    def _cohesive(nodes: LawNodes) -> Array:
        """(k,) what nodes that press by more than rounding bear beside friction [force]."""
        presses = nodes.N > NO_PRESSURE * np.abs(nodes.N).max(initial=0.0)
        return np.where(presses, nodes.given["cohesive"], 0.0)

    def rows(self, nodes: LawNodes) -> LawRows:
        T, s, delta = nodes.force, nodes.sums(self._bound(nodes)), nodes.slip
        if self.method == "switch":
            rows = switch_rows(T, s, delta, nodes.c, nodes.status)
        else:
            rows = newton_rows(T, s, delta, nodes.c, nodes.status, nodes.trust)
        # N of the next iterate stands in the rows, cohesion does not depend on it.
        cohesion = nodes.sums(self._cohesive(nodes))
        rhs = rows.rhs - rows.C_N * cohesion[:, None]
        return replace(rows, rhs=rhs, weight=self.coefficient(nodes))

    def miss(self, nodes: LawNodes) -> Array:
        s = nodes.sums(self._bound(nodes))
        return projection_miss(nodes.force, s, nodes.slip, nodes.c)

    def strength(self, nodes: LawNodes) -> Array:
        return self._bound(nodes)

    def at_stake(self, nodes: LawNodes) -> Array:
        # At the limit and without slip a node sticks and slips alike.
        z = nodes.force + nodes.c[:, None] * nodes.slip
        apart = np.abs(_length(z) - nodes.sums(self._bound(nodes)))
        return np.minimum(super().at_stake(nodes), apart)


def _at_least_0(name: str, values: Array, n: int) -> Array:
    if values.shape != (n,) or not (np.isfinite(values) & (values >= 0.0)).all():
        least = f" and the least value {values.min():g}" if values.size else ""
        raise ContactInputError(
            f"Coulomb: {name} has the shape {values.shape}{least}: give a finite number of at "
            f"least 0 for each of {n} nodes"
        )
    return values


def _length(a: Array) -> Array:
    return np.linalg.norm(a, axis=1)


def projection_miss(T: Array, s: Array, delta: Array, c: Array) -> Array:
    """(n,) distance of T from the projection of z = T + c δ on the disc of radius s [force]."""
    z, s = T + c[:, None] * delta, np.maximum(s, 0.0)
    size = _length(z)
    return _length(T - z * (np.minimum(s, size) / np.maximum(size, 1e-300))[:, None])


def newton_rows(
    T: Array,
    s: Array,
    delta: Array,
    c: Array,
    before: Array | int = STICK,
    trust: float = UNBOUNDED,
) -> LawRows:
    """Semismooth Newton on T = projection of z = T + c δ, in the stabilised form of Hüeber, Stadler
    and Wohlmuth, SIAM J. Sci. Comput. 30 (2008) 572-596.

    Args:
        T: (n, d) tangential forces [force].
        s: (n,) bound of these, μ N; at most 0 where nothing presses [force].
        delta: (n, d) slip of this load step [length].
        c: (n,) positive [force / length]; the solution does not depend on it.
        before: (n,) status in the last iterate, or one for all: what has slipped is at the limit
            when the next load step begins, where rounding must not decide.
        trust: times s, that c δ is at most, by a smaller c. Bodies that contact alone holds slip
            by far more than s / c in an iterate, and there and back in the next: with little
            trust a slip that turns round sticks first.

    >>> T, s, delta = np.array([[1.0], [4.0], [1.0]]), np.array([3.0, 3.0, 0.0]), np.zeros((3, 1))
    >>> newton_rows(T, s, delta, np.ones(3)).status.tolist() == [STICK, SLIP, OPEN]
    True
    """
    n, d = T.shape
    s, closed, firm = np.maximum(s, 0.0), s > 0.0, c
    most = trust * s
    c = c * most / np.maximum(np.maximum(most, c * _length(delta)), 1e-300)
    z = T + c[:, None] * delta
    size = _length(z)
    limit = s * np.where(before == SLIP, 1.0 - AT_LIMIT, 1.0 + AT_LIMIT)
    status = np.where(~closed, OPEN, np.where(size < limit, STICK, SLIP))
    direction, M = z / np.maximum(size, 1e-300)[:, None], stable_slip(T, z, s)
    slip = (status == SLIP)[:, None, None]
    stick = (status == STICK)[:, None, None]
    unit, c, firm = np.broadcast_to(np.eye(d), (n, d, d)), c[:, None, None], firm[:, None, None]
    return LawRows(
        status,
        C_T=np.where(stick, 0.0, np.where(slip, unit - M, unit)),
        C_jump=np.where(stick, firm * unit, np.where(slip, -c * M, 0.0)),
        C_N=np.where(slip[:, 0], -direction, 0.0),
        rhs=np.where(slip[:, 0], -np.einsum("nij,nj->ni", M, z), 0.0),
    )


def stable_slip(T: Array, z: Array, s: Array) -> Array:
    """(n, d, d) derivative of s z / |z| by z where T = s z / |z|, and what is stable elsewhere,
    e (1 - beta T dᵀ / max(s, |T|)), e = min(s / |z|, 1); arguments as of ``newton_rows``."""
    size, t = (np.maximum(_length(a), 1e-300) for a in (z, T))
    d, largest = z / size[:, None], np.maximum(np.maximum(s, t), 1e-300)
    cosine = np.einsum("ni,ni->n", T, d) / t
    beta = 1.0 / (1.0 - np.minimum(cosine, 0.0) * t / largest)
    outer = beta[:, None, None] * (T / largest[:, None])[:, :, None] * d[:, None, :]
    return (np.minimum(s, size) / size)[:, None, None] * (np.eye(z.shape[1]) - outer)


def switch_rows(T: Array, s: Array, delta: Array, c: Array, before: Array) -> LawRows:
    """The paper's switch: stick until |T| exceeds μ N, slip until the slip turns round.

    A node that begins to slip takes the direction of its force (16), one that slips that of its
    slip (17), both of the last iterate; the size of the force follows N of this one.

    Args:
        T, s, delta, c: as in ``newton_rows``.
        before: (n,) status in the last iterate.
    """
    n, d = T.shape
    was_slip = before == SLIP
    force, slip = _length(T), _length(delta)
    turned = np.einsum("ni,ni->n", T, delta) < 0.0
    slips = np.where(was_slip, ~turned & (slip > 0.0), force > np.maximum(s, 0.0))
    status = np.where(s <= 0.0, OPEN, np.where(slips, SLIP, STICK))
    direction = np.where(
        was_slip[:, None],
        delta / np.maximum(slip, 1e-300)[:, None],
        T / np.maximum(force, 1e-300)[:, None],
    )
    stick = (status == STICK)[:, None, None]
    unit, c = np.broadcast_to(np.eye(d), (n, d, d)), c[:, None, None]
    return LawRows(
        status,
        C_T=np.where(stick, 0.0, unit),
        C_jump=np.where(stick, c * unit, 0.0),
        C_N=np.where((status == SLIP)[:, None], -direction, 0.0),
        rhs=np.zeros((n, d)),
    )
