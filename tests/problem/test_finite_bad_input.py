"""Steps that cannot be taken at finite deformation, and nodes that leave the frame."""

import logging
import re

import numpy as np
import pytest
import ufl
from conftest import run_mpi_json
from pressed_scenes import Punch, small_strains
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm.finite import newton, passage

THROUGH = r"pass through each other: [1-9]\d* node.* by 1.5 where facets have the size 0"
CLOSED = r"pass through each other: [1-9]\d* node.* whose outline is closed; .* by [01]\."
INSIDE_OUT = r"elements turn inside out: [1-9]\d*, the first drawn at \["


@pytest.mark.parametrize("kind", [longer("quad"), "tet"])
def test_bodies_pass_through_each_other(kind, monkeypatch):
    """A punch is moved by three of its heights, from where it is far, in one step: not accepted;
    smaller steps find contact."""
    monkeypatch.setattr(newton, "HALVINGS", 0)
    punch = Punch(kind, lift=0.8)
    with pytest.raises(llm.ContactError, match=THROUGH):
        punch.to(down=1.5)
    assert all(np.allclose(u.x.array[punch.dim - 1 :: punch.dim], up)
               for u, up in zip(punch.u, (0.0, 0.8), strict=True))  # fmt: skip
    found = punch.to(down=0.05, increments=4)
    assert len({h["part"] for h in punch.problem.history}) == 4
    once = Punch(kind).to(down=0.05)
    assert np.allclose(found.resultant, once.resultant, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("kind", ["quad", "tet"])
def test_bodies_pass_through_closed_outlines(kind, monkeypatch):
    """A punch is carried to the other side of the foundation in one step: no node is behind a facet
    then, but the whole outline is tagged, and nodes have been inside. Beside it they may pass."""
    monkeypatch.setattr(newton, "HALVINGS", 0)
    punch = Punch(kind, lift=1.5, closed=True)
    with pytest.raises(llm.ContactError, match=CLOSED):
        punch.to(down=3.0)
    assert np.allclose(punch.u[1].x.array[punch.dim - 1 :: punch.dim], 1.5)
    punch.to(down=-1.5, along=3.0)
    found = punch.to(down=3.0, along=3.0)
    assert not found.resultant.any()


@pytest.mark.parametrize("k", [2, 3, 4])
def test_inside(k):
    """Points in and around a rough cube or square, against its own box."""
    gdim = 2 if k == 2 else 3
    corners = np.array(np.meshgrid(*[[0.0, 1.0]] * gdim, indexing="ij")).reshape(gdim, -1).T
    faces = np.array([[0, 1], [1, 3], [3, 2], [2, 0]])
    if k > 2:
        faces = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4],
                          [1, 5, 7, 3]])  # fmt: skip
    if k == 3:
        faces = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    x = np.random.default_rng(7).uniform(-0.5, 1.5, (300, gdim))
    within = ((x > 0.0) & (x < 1.0)).all(axis=1)
    assert np.abs(passage.winding(x, corners, faces) - within).max() < 1e-12
    found = passage.depth(x, corners, faces)
    nearest = np.linalg.norm(x[:, None] - corners, axis=2).min(axis=1)
    assert np.allclose(found, np.where(within, nearest, 0.0), rtol=0.0, atol=1e-15)
    shift = 3.0 * np.eye(gdim)[-1]
    deep, size = passage.deepest((x + shift, x - shift), (corners, corners), faces)
    above = ((x > 0.1) & (x < 0.9))[:, :-1].all(axis=1)
    assert size <= 1.0 and (deep[above] > 0.0).all() and not deep[x[:, 0] < 0.0].any()


def test_halving_finds_what_a_step_has_passed():
    punch = Punch("quad", lift=0.41)
    found = punch.to(down=0.41)
    parts = {h["part"] for h in punch.problem.history}
    assert len(parts) > 1
    assert np.allclose(found.resultant, Punch("quad").to(down=0.41).resultant, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("kind", ["tri", "hex"])
def test_elements_inside_out(kind, monkeypatch):
    """Bodies whose residual is a finite number all the same."""
    monkeypatch.setattr(newton, "HALVINGS", 0)
    punch = Punch(kind, llm.Tied(), energy=small_strains)
    with pytest.raises(llm.ContactError, match=INSIDE_OUT):
        punch.to(down=2.0)
    assert not any(u.x.array.any() for u in punch.u)
    assert punch.to(down=0.1).resultant[-1] > 0.0


@pytest.mark.parametrize("kind", ["quad", longer("hex")])
def test_nodes_leave_the_frame(kind, caplog):
    """They bear nothing beyond its edge, which is said once; the way back is open."""
    punch = Punch(kind)
    known = punch.to(down=0.05).resultant
    with caplog.at_level(logging.WARNING, "dolfinx_llm"):
        assert not caplog.messages
        found = punch.to(down=0.05, along=2.0)
    (said,) = caplog.messages
    count = 5 if kind == "quad" else 16
    assert f"{count} node(s) of tag 2" in said and "left tag 1 over its edge" in said
    assert not found.resultant.any() and not (found.sides[1].status > 0).any()
    again = punch.to(down=0.05)
    assert np.allclose(again.resultant, known, rtol=1e-8, atol=1e-8 * abs(known[-1]))


def test_what_was_reached_is_kept(monkeypatch):
    """The displacement, the results and the start of the next step are those of one state."""
    monkeypatch.setattr(newton, "HALVINGS", 0)
    monkeypatch.setattr(newton, "NEWTON_ITERATIONS", 12)
    punch = Punch("tri", lift=0.2)
    with pytest.raises(llm.ContactError, match="Newton's iteration fails at") as told:
        punch.to(down=2.0, increments=5)
    part = float(str(told.value).split("The state at ")[1].split()[0])
    (result,) = punch.problem.results
    down = punch.u[1].x.array[1::2].min()
    assert 0.0 < part < 1.0 and down == pytest.approx(0.2 - 2.2 * part, abs=1e-3)
    assert result.sides[1].u[:, 1].min() >= down and (result.sides[1].status > 0).any()


def test_u_changed_by_hand():
    """Before the first load step it is where that starts; later on it was not read, without a word,
    and is an error."""
    known = Punch("quad").to(down=0.05).resultant
    punch = Punch("quad")
    free = punch.u[0].x.array
    free[:] = 1e-3 * np.sin(np.arange(len(free)))
    assert np.allclose(punch.to(down=0.05).resultant, known, rtol=1e-8, atol=1e-8 * abs(known[-1]))
    found = free.copy()
    free[:] *= 1.1
    with pytest.raises(llm.ContactInputError, match=r"changed at \d+ dof.s. since .* reset"):
        punch.to(down=0.06)
    free[:] = found
    assert abs(punch.to(down=0.06).resultant[-1]) > abs(known[-1])


@pytest.mark.parametrize(
    ("scene", "pattern"),
    [
        ("passes", THROUGH),
        longer("inside out", INSIDE_OUT),
        longer("leaves", r"5 node.s. of tag 2 that carried force have left tag 1"),
    ],
)
def test_two_ranks(scene, pattern):
    """The same errors and warnings; all ranks raise together, one warns."""
    said = run_mpi_json("finite_bad_input.py", 2, scene)
    assert [len(texts) for texts in said.values()] == ([0, 1] if scene == "leaves" else [1, 0])
    (text,) = sum(said.values(), [])
    assert re.search(pattern, text)


def test_starts_that_are_none(monkeypatch):
    """A displacement that is no number, and one that turns elements inside out, from where Newton's
    iteration was tried in ever smaller increments, which do not help."""

    def thin(u, mu, _):  # in plane stress: finite where elements are inside out
        C = ufl.Identity(2) + 2.0 * ufl.sym(ufl.grad(u)) + ufl.grad(u).T * ufl.grad(u)
        return mu / 2 * (ufl.tr(C) + 1.0 / ufl.det(C))

    punch = Punch("quad", energy=thin)
    u = punch.u[0].x.array
    u[:] = np.nan
    with pytest.raises(llm.ContactInputError, match=rf"u has {len(u)} entries that are NaN"):
        punch.problem.reset()
    punch.u[0].interpolate(lambda x: np.stack([-2.5 * x[0] * (abs(x[1] - 0.5) < 0.3), 0.0 * x[1]]))
    punch.problem.reset()
    monkeypatch.setattr(newton, "NEWTON_ITERATIONS", 10)
    with pytest.raises(llm.ContactError, match=r"inside out where the load step starts: [1-9]"):
        punch.to(down=0.1)
    u[:] = 0.0
    punch.problem.reset()
    assert punch.to(down=0.1).resultant[-1] > 0.0
