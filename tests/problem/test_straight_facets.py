"""Second-order bodies on first-order meshes of curved surfaces, whose facets are straight."""

import bent_rings
import numpy as np
import pytest
from lame_rings import Lame, quarters
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm.design.rises import rises
from dolfinx_llm.geometry.surface import Surface, extract_surface

MESHES = [
    ("quad", (0.2, 0.13), 0.03),
    longer("hex", (0.3, 0.2), 0.04),
    ("tet", (0.3, 0.2), 0.9),
    longer("tet", (0.2, 0.13), 0.5),
    longer("tet", (0.12, 0.08), 0.35),
]


class Lame2(Lame):
    degree = 2


@pytest.mark.parametrize("law", [llm.Frictionless(), longer(llm.Coulomb(0.3))])
@pytest.mark.parametrize(("kind", "sizes", "most"), MESHES)
def test_pressed(kind, sizes, most, law):
    """Nodes between corners lie below the surface that these are on: pressures were off by 50 % on
    quadrilaterals and hexahedra, by 1,000 % on tetrahedra."""
    exact = Lame2()
    problem = exact.nonlinear(quarters(kind, sizes), law)
    problem.solve()
    (result,), p = problem.results, exact.pressure(1.5)
    assert np.abs(result.pressure - p).max() <= most * p
    assert len(problem.history) <= 10


@pytest.mark.parametrize("gdim", [2, longer(3)])
def test_in_a_bore(gdim, caplog):
    """The inner part in a rigid bore that gives way as the outer part would; linear problems, whose
    gaps are those of the mesh, say that facets are straight."""
    exact = Lame2()
    radius = 1.5 + exact.radial(1.5)
    bore = {
        2: lambda: llm.RigidSphere((0.0, 0.0), radius, inside=True),
        3: lambda: llm.RigidCylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), radius, inside=True),
    }[gdim]()
    inner = bent_rings.bricks(0.2, 1.0, 1.5, 1, order=1, gdim=gdim)
    problem = exact.nonlinear([inner], llm.Frictionless(), obstacle=bore)
    problem.solve()
    p = exact.pressure(1.5)
    assert np.abs(problem.results[0].pressure - p).max() <= 0.07 * p
    problem = exact.linear([inner], llm.Frictionless(), "auto", obstacle=bore)
    assert "lie up to 0.00321 below the surface" in caplog.text
    assert "setOrder(2)" in str(problem)


@pytest.mark.parametrize("kind", ["quad", "hex", "tet"])
def test_rises(kind):
    """Of circles and cylinders to rounding, of tetrahedra's triangles to the fit's; none where
    meshes are of second order, or where all is flat."""
    exact = Lame2()
    for order in (1, 2):
        (domain, tags), _ = quarters(kind, (0.2, 0.13), order)
        (u,) = exact.given([(domain, tags)])[1]
        surface = extract_surface(u.function_space, tags, 2)
        below = 1.5 - np.hypot(*surface.x[:, :2].T)
        found = rises(surface)
        if order == 2:
            assert not found.any()
        else:
            assert below.max() > 2e-3
            assert np.abs(found - below).max() <= (1e-6 if kind == "tet" else 1e-11)


def test_a_bend_is_no_curve():
    """Two plates at 45 degrees, of two facets each."""
    t = np.linspace(-1.0, 1.0, 9)
    x = np.column_stack([np.where(t < 0.0, t, t * np.sqrt(0.5)), np.maximum(t, 0.0) * np.sqrt(0.5)])
    at = np.arange(0, 8, 2)
    cells = np.column_stack([at, at + 2, at + 1])
    own = np.arange(9)
    surface = Surface(x, cells[:, :2], own, 0 * own, "bend", elements=cells)
    assert surface.element.order == 2 and not rises(surface).any()


@pytest.mark.parametrize("first", [0.05, 0.3])
def test_units(first):
    """Rows of ties do not depend on them: where solves leave nearly the same, rounding chose which
    one was the last."""
    known = None
    for size in (1.0, 1e-3, 3.0):
        parts = zip((24, 16), ((1.0, 1.5, 0.0), (1.5, 2.0, first)), (1, 3), strict=True)
        meshes = [bent_rings.ring(n, *part, 1, tag) for n, part, tag in parts]
        for domain, _ in meshes:
            domain.geometry.x[:] *= size
        problem = bent_rings.joined(meshes)
        rows = [pairs.N for pairs in problem.geometries[0].pairs]
        problem.destroy()
        known = known or rows
        assert max(abs(N - M).max() for N, M in zip(rows, known, strict=True)) <= 1e-5
