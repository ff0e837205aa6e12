"""What the forms of (31) cost, estimated before anything is solved.

Work is seconds of one core of 2020 for the load steps expected, memory what comes on top of the
bodies' stiffness. A few constants carry it, each of one thing that a machine or a solver does;
measured by ``tests/shared/cost_campaign.py``, which holds the choice against all forms.

Sparse factors of a body of n unknowns, nested dissection: n log n entries in 2D, n^(4/3) in 3D,
where elimination itself takes n² operations; each further right-hand side reads all of it, many at
once compute instead. Multigrid: all is proportional to the unknowns, and counted in solves of a
tied interface, of some 20 iterations of CG.
"""

from dataclasses import dataclass

import numpy as np

from dolfinx_llm.operators.system import ContactOperators

RATE = 3.5e10  # operations a second in dense blocks, as BLAS does them
ENTRIES = {2: 4.5, 3: 16.5}  # of a factor, over n log2 n in 2D, n^(4/3) in 3D
ELIMINATED = 28.0  # operations of a factorisation in 3D over n²; in 2D entries tell all
ORDERED = 3e-6  # seconds for an unknown before it is eliminated: ordering, analysis
MADE = 5e-8  # seconds for an entry of a factor: assembly, memory
READ = 8e-9  # ... in a solve, refined
STORED = 20e-9  # gigabytes of an entry, with MUMPS's spare memory
DENSE = 48e-9  # ... of a dense matrix: with its factors, and copies while it is made
PASSED = 5e-8  # seconds for an unknown of a right-hand side, of many solved at once
ROW = {2: 18, 3: 81}  # entries of a row of the stiffness, bricks of first order
SWEPT = 9e-8  # seconds for such an entry in a solve by multigrid; grows with the order to the 1.5
BUILT = 2.0  # such solves that making multigrid costs
LOAD_STEPS = 4  # expected of a problem: of laws that open or slip, from stick to gross slip
# Over so many steps: matrices that differ where friction changes what slips, and solves by
# multigrid in which the law comes to rest, without friction and with it.
CHANGES, OPENING, SLIPPING = 10, 10.0, 22.0
MEETING = 6.0  # solves more where it is open at first which pairs will touch
# ... and between two bodies, along surfaces that part: forces of corrected rows die out from frame
# node to frame node beside contact, and are found in solves to rounding.
BETWEEN_BODIES = 100.0
SINGLY = 100  # pairs of these at most, half of those that the factorised form asks for singly
FEWEST = 3000  # unknowns from which on the condensed form takes multigrid with friction
APART = 1e-6  # of the surface's size: gap from which on a pair does not touch as drawn


@dataclass(frozen=True)
class Scene:
    """What the estimate knows of a problem; the same on every rank."""

    dim: int  # of space
    order: int  # of the bodies' cells
    bodies: tuple[int, ...]  # unknowns of each body
    rows: int  # multipliers
    frame: int  # unknowns of frames and slips
    motions: int  # of bodies that supports do not hold
    parted: int  # pairs of which it is open at first whether they touch
    opens: bool  # whether pairs may part
    slips: bool  # whether the rows of a law change with what slips, or gives way
    ranks: int = 1
    steps: int = LOAD_STEPS  # expected
    framed: bool = False  # whether ``parted`` has pairs of two bodies, with a frame between

    @classmethod
    def of(cls, operators: ContactOperators, steps: int = LOAD_STEPS) -> "Scene":
        """That of a problem; collective.

        Args:
            operators: of its interfaces.
            steps: expected; of more than ``LOAD_STEPS``, as in time, all pairs may come and go.
        """
        laws = [geometry.interface.law for geometry in operators.geometries]
        dofs, label = operators.dofs, operators.bodies.label
        counts = np.bincount(label, minlength=operators.bodies.count) * dofs.components
        counts = operators.comm.allreduce(counts)
        motions = 0 if operators.tied else operators.floating.rigid.modes.shape[1]
        parted, framed, loose = 0, False, motions > 0 or steps > LOAD_STEPS
        for geometry in operators.geometries:
            law = geometry.interface.law
            for pairs in geometry.pairs if law.opens else ():
                size = np.ptp(pairs.x, axis=0).max(initial=0.0)
                gaps = np.abs(pairs.gap).max(axis=1) if law.closes_gap else np.zeros(len(pairs.gap))
                apart = int((gaps > APART * size).sum())
                framed |= apart > 0 and geometry.interface.obstacle is None
                parted += apart if not loose else len(gaps)
        return cls(
            dim=dofs.gdim,
            order=dofs.order,
            bodies=tuple(int(n) for n in counts),
            rows=operators.counts["lambda"],
            frame=operators.unknowns.sizes[1],
            motions=motions,
            parted=parted,
            framed=framed,
            opens=any(law.opens for law in laws),
            slips=any(law.slips or (law.gives and law.opens) for law in laws),
            ranks=operators.comm.size,
            steps=steps,
        )

    @property
    def unknowns(self) -> int:
        """Of all bodies."""
        return sum(self.bodies)

    @property
    def turns(self) -> float:
        """Times that it goes through ``LOAD_STEPS``."""
        return self.steps / LOAD_STEPS


@dataclass(frozen=True)
class Cost:
    """Of all load steps in a form."""

    seconds: float
    gigabytes: float

    def __str__(self) -> str:
        return f"{self.seconds:.2g} s, {self.gigabytes:.2g} GB"


def costs(scene: Scene) -> dict[str, Cost]:
    """What the forms cost, by name.

    Args:
        scene: of the problem.
    """
    saddle, condensed = _saddle(scene), _condensed(scene)
    if not (scene.opens or scene.slips):
        return {"saddle": saddle, "condensed": condensed}
    return {"flexibility": _flexibility(scene), "saddle": saddle, "condensed": condensed}


def entries(n: float, dim: int) -> float:
    """Of the factor of n unknowns, symmetric.

    Args:
        n: unknowns.
        dim: of space.
    """
    n = max(n, 2.0)
    return float(ENTRIES[dim] * (n * np.log2(n) if dim == 2 else n ** (4.0 / 3.0)))


def _factorised(parts: tuple[int, ...], dim: int, twice: int = 1) -> tuple[float, float]:
    """Entries of the factor of parts that are hardly coupled, and the seconds that it takes; with
    ``twice`` 2 of a matrix that is not symmetric."""
    fill = sum(entries(n, dim) for n in parts)
    dense = sum(ELIMINATED * float(n) ** 2 for n in parts) if dim == 3 else 0.0
    return fill, ORDERED * sum(parts) + MADE * fill + twice * dense / RATE


def _saddle(scene: Scene) -> Cost:
    """(31) factorised for each matrix, the parts being bodies and interfaces; unsymmetric with
    friction."""
    parts = (*scene.bodies, scene.rows + scene.frame)
    twice = 2 if scene.slips else 1
    fill, made = _factorised(parts, scene.dim, twice)
    matrices = CHANGES * scene.turns if scene.slips else 1
    solves = (2.0 if scene.opens or scene.slips else 1.0) * scene.steps
    solves += scene.turns * (min(scene.parted, 2 * SINGLY) // 2)
    seconds = matrices * made + solves * READ * fill
    return Cost(seconds / scene.ranks, STORED * twice * fill)


def _flexibility(scene: Scene) -> Cost:
    """The bodies factorised and asked once, then dense systems, on one rank."""
    fill, bodies = _factorised(scene.bodies, scene.dim)
    bodies += scene.rows * (PASSED * scene.unknowns + 4.0 * fill / RATE)
    bodies += 2 * scene.steps * READ * fill
    size = scene.rows + scene.frame + scene.motions
    matrices = scene.turns * (CHANGES if scene.slips else scene.parted > 0) + 1
    dense = matrices * 2.0 / 3.0 * float(size) ** 3 / RATE
    return Cost(bodies / scene.ranks + dense, STORED * fill + DENSE * float(size) ** 2)


def _condensed(scene: Scene) -> Cost:
    """Multigrid, made once, and Krylov's iterations; the matrices are those of the bodies, a few
    times. With friction and few unknowns factorised."""
    if scene.slips and scene.unknowns < FEWEST:
        return _saddle(scene)
    step = SWEPT * ROW[scene.dim] * scene.order**1.5 * scene.unknowns
    solves = SLIPPING if scene.slips else OPENING if scene.opens else float(LOAD_STEPS)
    solves += MEETING * (scene.parted > 0) + BETWEEN_BODIES * (scene.framed and not scene.slips)
    solves = BUILT + scene.turns * solves
    copies = 4 if scene.slips else 2 if scene.opens else 1
    gigabytes = copies * 12e-9 * ROW[scene.dim] * scene.order * scene.unknowns
    return Cost(solves * step / scene.ranks, gigabytes)
