"""Rigid obstacles that turn, and those pressed by a force in the place of a displacement."""

import numpy as np
import pytest
from contact_scenes import NU, E
from rigid_scenes import FORMS, Block, stack
from sampling import drawn, some_of

import dolfinx_llm as llm
from dolfinx_llm.forms.step import StepForm

LAWS = [llm.Frictionless(), llm.Coulomb(0.3)]
KINDS = ["triangle", "hexahedron"]


def up(gdim, value, across=None):
    """A vector of the block's axis, with ``across`` in the other components."""
    return (across,) * (gdim - 1) + (value,)


def plane(R, **given):
    return llm.RigidPlane(np.zeros(len(R)), R[:, -1], **given)


def ball(R, **given):
    return llm.RigidSphere(-2.05 * R[:, -1], 2.0, **given)


@pytest.mark.parametrize(("kind", "law", "form"), drawn(KINDS, LAWS, FORMS))
def test_force_is_the_resultant_and_gives_the_displacement(kind, law, form):
    """A ball pressed with F: the body answers with -F, also after another load step; where the ball
    is pushed to the same place the same forces arise."""
    gdim = 2 if kind == "triangle" else 3
    block = Block(kind, lambda R: ball(R, force=up(gdim, 100.0)), law, form)
    places = []
    for force in (100.0, 160.0):
        result = block.solve(force=up(gdim, force))
        assert result.resultant[-1] == pytest.approx(-force, rel=1e-12)
        assert 0 < (result.sides[0].status > 0).sum() < len(result.sides[0].x)
        assert not result.displacement[:-1].any()
        places.append(result.displacement)
    pushed = Block(kind, ball, law, form)
    pushed.solve(displacement=places[0])
    other = pushed.solve(displacement=places[1])
    size = np.abs(result.sides[0].u).max()
    assert np.abs(result.sides[0].u - other.sides[0].u).max() < 1e-11 * size
    assert np.abs(result.sides[0].force - other.sides[0].force).max() < 1e-9 * force


@pytest.mark.parametrize("proximal", [3e-14, 5e-13, 1e-12, 1e-11])
def test_what_holds_free_nodes_bears_nothing(proximal, monkeypatch):
    """However firmly an obstacle is held until it is where it touches, at rest contact balances its
    force alone: 2e-11 of it was left where pairs had changed last, since solves may be loose."""
    monkeypatch.setattr(StepForm, "proximal", proximal)
    block = Block(
        "triangle", lambda R: ball(R, force=up(2, 100.0)), llm.Frictionless(), "condensed"
    )
    for force in (100.0, 160.0):
        result = block.solve(force=up(2, force))
        assert result.resultant[-1] == pytest.approx(-force, rel=1e-12)


@pytest.mark.parametrize(("kind", "law"), list(zip(KINDS, LAWS)))
def test_force_in_any_direction(kind, law):
    """All of a ball's translations are free: it goes where both components of a force are in
    balance; turned scenes turn the answer."""
    gdim = 2 if kind == "triangle" else 3
    found = []
    for seed in (None, 3):
        block = Block(kind, lambda R: ball(R, force=tuple(R @ up(gdim, 80.0, 6.0))), law, seed=seed)
        result = block.solve()
        assert block.own(result.resultant) == pytest.approx(-np.array(up(gdim, 80.0, 6.0)))
        side = result.sides[0]
        order = np.lexsort(block.own(side.x).round(9).T)
        found.append(block.own(np.vstack([result.displacement, side.u[order]])))
    assert np.abs(found[0] - found[1]).max() < 1e-10 * np.abs(found[0]).max()


@pytest.mark.parametrize("kind", KINDS)
def test_column_under_a_force(kind):
    """Uniaxial stress: the plane moves by F h / (E A), with E / (1 - ν²) in plane strain; released
    it presses no longer, and from afar it comes to the body."""
    gdim = 2 if kind == "triangle" else 3
    modulus, area = (E / (1 - NU**2), 2.0) if gdim == 2 else (E, 4.0)
    block = Block(kind, lambda R: plane(R, force=up(gdim, 50.0)), llm.Frictionless(), rollers=True)
    for force in (50.0, 0.0, 20.0):
        result = block.solve(force=up(gdim, force))
        shift = force / (modulus * area)
        assert result.displacement[-1] == pytest.approx(shift, rel=1e-11, abs=1e-14)
        assert result.resultant[-1] == pytest.approx(-force, abs=1e-11)
        assert result.pressure == pytest.approx(force / area, abs=1e-9)
    lower = llm.RigidPlane(up(gdim, -0.3, 0.0), up(gdim, 1.0, 0.0), force=up(gdim, 50.0))
    block = Block(kind, lambda R: lower, llm.Frictionless(), rollers=True)
    assert block.solve().displacement[-1] == pytest.approx(0.3 + 50.0 / (modulus * area), rel=1e-11)


PRESSED = [
    ((llm.Tied(), llm.Frictionless()), (None, -50.0)),
    ((llm.Tied(), llm.Coulomb(0.2)), (2.0, -50.0)),
    ((llm.Coulomb(0.3), llm.Frictionless()), (None, -50.0)),
    ((llm.Coulomb(0.3), llm.Coulomb(0.2)), (2.0, -50.0)),
]


@pytest.mark.parametrize("laws, force", some_of(PRESSED, PRESSED[1:3]))
def test_force_goes_through_a_stack(laws, force):
    """Frames beside an obstacle under force: its force passes through both interfaces, and the
    forms of (31) agree."""
    answers = []
    for form in FORMS:
        problem, u = stack(laws, form, force)
        answers.append(u)
        for result in problem.results:
            assert result.resultant == pytest.approx([-(force[0] or 0.0), 50.0], abs=1e-10)
    assert max(np.abs(u - answers[0]).max() for u in answers) < 1e-11 * np.abs(answers[0]).max()


@pytest.mark.parametrize("form", some_of(FORMS, ["condensed"]))
def test_stick_and_slide_under_a_force(form):
    """A force within the cone of friction is held; beyond it, or pulling, it is refused within
    seconds, and the next load step goes on from before."""
    answers = [stuck(form, refused) for refused in (False, True)]
    assert np.abs(answers[0] - answers[1]).max() < 1e-11


def stuck(form, refused):
    """Displacement under forces that grow, with some between that are refused."""
    block = Block("triangle", lambda R: plane(R, force=(0.0, 100.0)), llm.Coulomb(0.3), form)
    for across in (0.0, 15.0):
        result = block.solve(force=(across, 100.0))
        assert result.resultant == pytest.approx([-across, -100.0], abs=1e-9)
    for force in ((35.0, 100.0), (0.0, -1.0)) if refused else ():
        with pytest.raises(llm.ContactError, match="does not balance the force on the RigidPlane"):
            block.solve(force=force)
    return block.solve(force=(25.0, 100.0)).sides[0].u


def test_refused():
    """Forces that nothing resists, for other components than before."""
    frictionless = llm.Frictionless()
    with pytest.raises(llm.ContactError, match=r"nothing resists the part \[1.0, 0.0\]"):
        Block("triangle", lambda R: plane(R, force=(1.0, 9.0)), frictionless).solve()
    along = Block("triangle", lambda R: plane(R, force=(1.0, None)), frictionless)
    with pytest.raises(llm.ContactError, match=r"nothing resists the part \[1.0, 0.0\]"):
        along.solve()  # with nothing that contact resists
    assert np.abs(along.solve(force=(0.0, None)).resultant).max() < 1e-12
    block = Block("triangle", lambda R: plane(R, force=(None, 9.0)), frictionless)
    with pytest.raises(llm.ContactInputError, match="Make the problem anew"):
        block.solve(force=(0.0, 9.0))
    with pytest.raises(llm.ContactInputError, match="component 1 has both"):
        block.solve(force=(None, 9.0), displacement=(0.0, 1.0))


@pytest.mark.parametrize("law", [llm.Tied(), *LAWS], ids=str)
@pytest.mark.parametrize("kind", KINDS)
def test_body_and_obstacle_turn_together(kind, law):
    """A rigid motion of both adds no force to those of being pressed: the same shift and rotation
    about any pivot of the obstacle and of the body's top."""
    block = Block(kind, plane, law, seed=3)
    gdim, shift = block.gdim, up(block.gdim, 0.02, 0.01)
    pressed = block.solve(displacement=shift)
    block.problem.reset()
    turn = 0.07 if gdim == 2 else (0.03, -0.02, 0.05)
    pivot = tuple(block.R @ np.full(gdim, 0.4))
    arm = np.array([[0.0, -turn], [turn, 0.0]]) if gdim == 2 else np.cross(np.eye(3), turn)
    arm = arm if gdim == 2 else -arm.T @ np.eye(3)
    block.top.interpolate(lambda p: arm @ (p[:gdim] - np.array(pivot)[:, None]))
    block.obstacle.rotation, block.obstacle.pivot = turn, pivot
    turned = block.solve(displacement=shift)
    assert np.abs(turned.sides[0].force - pressed.sides[0].force).max() < 1e-9
    moved = (pressed.sides[0].x - pivot) @ arm.T
    assert np.abs(turned.sides[0].u - pressed.sides[0].u - moved).max() < 1e-12


@pytest.mark.parametrize("kind", KINDS)
def test_spinning_roller(kind, caplog):
    """A roller that is pressed and turned about its axis drags all that it touches: friction is
    μ N, its moment about the axis μ N R, to either side, at any angle."""
    mu, gdim, radius = 0.3, 2 if kind == "triangle" else 3, 2.0
    centre = np.array(up(gdim, -2.0, 0.0))

    def roller(R):
        given = dict(force=up(gdim, 100.0))
        if gdim == 2:
            return llm.RigidSphere(centre, radius, **given)
        return llm.RigidCylinder(centre, (0, 1, 0), radius, **given)

    block = Block(kind, roller, llm.Coulomb(mu))
    for angle, way in ((40.0, 1.0), (-25.0, -1.0)):
        result = block.solve(rotation=angle if gdim == 2 else (0.0, angle, 0.0))
        side = result.sides[0]
        assert (side.status[side.status > 0] == 2).all()
        normal = side.normal_force.sum()
        rel = 1e-9 if gdim == 2 else 1e-5  # in 3D slip of the body's own turns its direction
        assert np.linalg.norm(side.tangential_force, axis=1).sum() == pytest.approx(mu * normal)
        distance, into = block.obstacle.clearance(side.x)
        arm = side.x + distance[:, None] * into - centre
        force = side.tangential_force
        moment = (arm[:, 0] * force[:, -1] - arm[:, -1] * force[:, 0]).sum() * (3 - 2 * (gdim - 1))
        assert moment == pytest.approx(-way * mu * normal * radius, rel=rel)
        assert result.resultant[-1] == pytest.approx(-100.0)
    assert "slide" not in caplog.text and "turned by" not in caplog.text
    block.solve(rotation=None)
    block.obstacle.pivot = np.zeros(gdim)
    block.solve(rotation=0.12 if gdim == 2 else (0.0, 0.12, 0.0))
    assert "turned by 0.12" in caplog.text
