"""An interface between two surfaces: the user's choices."""

from dataclasses import dataclass, field
from typing import Any

from dolfinx_llm.base import checks
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.surface import check_facet_tags
from dolfinx_llm.geometry.thickness import check_thickness
from dolfinx_llm.interface.obstacle import Obstacle
from dolfinx_llm.laws.frictionless import Frictionless
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.tied import Tied

DESIGNS = ("auto", "positions", "weights", None)
SIDES = (
    "give two facet tags, e.g. (3, 7), or ((tags_0, 3), (tags_1, 7)); one may be a rigid obstacle"
)


@dataclass(frozen=True, eq=False)
class Interface:
    """Two surfaces in contact. Neither side is preferred; their order does not matter.

    It does not change once it is made: ``dataclasses.replace(interface, law=...)`` makes another.

    Args:
        facet_tags: dolfinx mesh tags of facets; unused where ``sides`` brings its own.
        sides: the two facet tags, e.g. (3, 7); or ((tags_0, 3), (tags_1, 7)) for two meshes. One
            of them may be a rigid obstacle, e.g. ``RigidPlane``. Whole surfaces of bodies may be
            tagged: what can touch is found facet by facet.
        law: contact law: ``Tied()``, ``Frictionless()``, ``Coulomb(mu)``, or one of your own
            (``Law``).
        frame: contact frame; None: predicted from the two surfaces.
        design: how the frame is made to pass the patch test (28): "weights" corrects the rows of
            L_b, "positions" moves the frame's nodes (paper, section 5; in 2D to the closed form
            of ``design.line``), None leaves it as it is, "auto" takes the closed form in 2D and
            corrects weights where the frame does not pass already.
        thickness: of bodies in the plane, by which areas, and so pressures, count: a positive
            number, or a linear function of positions (n, 2) that returns (n,); of axisymmetric
            bodies, with forms over 2 pi r dx, ``lambda x: 2.0 * np.pi * x[:, 0]`` [length]. None:
            1; of one problem all have a thickness or none.
        shift: (gdim,) vector from where side 1 is to where it meets side 0 [length]: with
            ``Tied()`` the bodies are periodic, whether or not the meshes of both sides match.

    Raises:
        ContactInputError: unknown design or law, sides that are no pair, a shift of what is not
            tied, a thickness that is none.
    """

    facet_tags: Any
    sides: Any
    law: Law = field(default_factory=Tied)
    frame: Frame | None = None
    design: str | None = "auto"
    shift: Any = None
    thickness: Any = None

    def __post_init__(self) -> None:
        check_thickness(self.thickness)
        checks.one_of("design", self.design, DESIGNS)
        checks.instance(
            "law",
            self.law,
            Law,
            "choose Tied(), Frictionless() or Coulomb(mu), or a law of your own (dolfinx_llm.Law)",
        )
        self.law.check()
        if self.frame is not None:
            checks.instance("frame", self.frame, Frame, "give a dolfinx_llm.Frame or None")
        sides = tuple(checks.items("sides", self.sides, SIDES))
        if len(sides) != 2:
            checks.refuse("sides", self.sides, SIDES)
        object.__setattr__(self, "sides", tuple(_side(side) for side in sides))
        rigid = sum(isinstance(side, Obstacle) for side in sides)
        if rigid == 2:
            raise ContactInputError("both sides are rigid obstacles: one must be a body")
        if rigid and self.frame is not None:
            raise ContactInputError("against a rigid obstacle there is no frame: leave frame=None")
        for tags, _ in self.tagged_sides():
            check_facet_tags("facet tags", tags)
        if self.shift is not None:
            accepted = "give a vector from side 1 to side 0, or None"
            shift = checks.array("shift", self.shift, (None,), accepted)
            if rigid or not self.law.ties:
                raise ContactInputError(
                    f"shift={shift.tolist()} with the law {self.law}: two sides that are tied may "
                    "lie apart by it; what opens or slips meets where it is drawn"
                )
            object.__setattr__(self, "shift", shift)

    def __repr__(self) -> str:
        framed = "" if self.frame is None else f", frame of {len(self.frame.x)} nodes"
        return f"{type(self).__name__}({self.name}, law={self.law}{framed}, design={self.design!r})"

    @property
    def name(self) -> str:
        """The two sides, for messages."""
        names = [
            type(side).__name__ if isinstance(side, Obstacle) else str(_tagged(self, side)[1])
            for side in self.sides
        ]
        return " | ".join(names)

    @property
    def obstacle(self) -> Obstacle | None:
        """The rigid side, if there is one."""
        return next((side for side in self.sides if isinstance(side, Obstacle)), None)

    def tagged_sides(self) -> list[tuple[Any, int]]:
        """The sides that are bodies, as (facet tags, tag)."""
        return [_tagged(self, side) for side in self.sides if not isinstance(side, Obstacle)]


class SelfContact(Interface):
    """A surface that may fold onto itself, at finite deformation; what touches is found by itself.

    Facets meet where they face each other and lie near, at the start of each increment; neighbours
    along the surface do not. Of two parts that meet, the coarser one's nodes are the frame's: the
    result's sides are the surface twice, as what moves on the frame and as what carries it.

    Args:
        facet_tags: dolfinx mesh tags of facets.
        tag: of the surface, which may be in several pieces.
        law: ``Frictionless()``, ``Coulomb(mu)`` or one of your own; None: ``Frictionless()``.
        design: "auto", "weights" or None, as of ``Interface``.
        thickness: as of ``Interface``.

    Raises:
        ContactInputError: ties, or another design.
    """

    def __init__(
        self,
        facet_tags: Any,
        tag: int,
        law: Law | None = None,
        design: str | None = "auto",
        thickness: Any = None,
    ) -> None:
        law = Frictionless() if law is None else law
        if isinstance(law, Tied):
            checks.refuse("law", law, "a surface that meets itself is not tied: take another law")
        if design == "positions":
            checks.refuse("design", design, 'choose "auto", "weights" or None')
        checks.integer("tag", tag, "give the facet tag of the surface")
        super().__init__(facet_tags, (tag, tag), law, design=design, thickness=thickness)

    @property
    def name(self) -> str:
        """The surface, for messages."""
        return f"{self.sides[0]} | itself"

    def tagged_sides(self) -> list[tuple[Any, int]]:
        """The surface, as (facet tags, tag)."""
        return super().tagged_sides()[:1]


def _tagged(interface: Interface, side: Any) -> Any:
    return side if isinstance(side, tuple) else (interface.facet_tags, side)


def _side(side: Any) -> Any:
    """A side as an obstacle, a tag, or a tuple of facet tags and tag."""
    if isinstance(side, Obstacle):
        return side
    if not isinstance(side, (tuple, list)):
        return checks.integer("sides: facet tag", side, SIDES)
    if len(side) != 2:
        checks.refuse("sides", side, SIDES)
    return side[0], checks.integer("sides: facet tag", side[1], SIDES)
