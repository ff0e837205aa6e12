"""Periodic cells whose opposite sides have meshes that do not match."""

import numpy as np
import pairs
import ufl
from contact_scenes import rectangle
from dolfinx import fem, mesh
from facing_scenes import tagged

import dolfinx_llm as llm
from dolfinx_llm import compat

E, NU = 100.0, 0.3


def bent(x, both):
    """Positions (n, gdim) in the unit cell, moved differently at opposite sides."""
    x = x.copy()
    x[:, 1] += 0.08 * x[:, 0] * np.sin(2 * np.pi * x[:, 1])
    if both:
        x[:, 0] += 0.06 * x[:, 1] * np.sin(2 * np.pi * x[:, 0])
    if x.shape[1] == 3 and both:
        x[:, 2] += 0.05 * (x[:, 0] - x[:, 1]) * np.sin(2 * np.pi * x[:, 2])
    return x


def cell(comm, gdim, kind, n, law, both=True, scalar=False, degree=1, **chosen):
    """The problem of a unit cell, its modulus by cells, its mean strain or gradient, and what makes
    a stress or flux of these."""
    corners = np.zeros(gdim), np.ones(gdim)
    make, dims = (rectangle, (n, n)) if gdim == 2 else (pairs.block, (n,) * 3)
    domain, _ = make(comm, dims, *corners, kind, move=lambda x: bent(x, both))
    sides = [
        mesh.locate_entities_boundary(domain, gdim - 1, lambda p, k=k, z=z: np.isclose(p[k], z))
        for k in range(gdim)
        for z in (0.0, 1.0)
    ]
    tags = tagged(domain, sides)
    shape = None if scalar else (gdim,)
    V = compat.function_space(domain, degree=degree, shape=shape)
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    modulus = fem.Function(compat.function_space(domain, "DG", 0))
    modulus.x.array[:] = E
    mean = fem.Constant(domain, np.zeros(gdim) if scalar else np.zeros((gdim, gdim)))

    def flux(strain):
        if scalar:
            return modulus * strain
        strain = ufl.sym(strain)
        trace = NU / (1 - 2 * NU) * ufl.tr(strain) * ufl.Identity(gdim)
        return modulus / (1 + NU) * (strain + trace)

    middle = fem.locate_dofs_geometrical(V, lambda p: np.isclose(p[:gdim], 0.5).all(axis=0))
    ties = [
        llm.Interface(tags, (2 * k + 1, 2 * k + 2), law=law, shift=-np.eye(gdim)[k])
        for k in range(gdim)
    ]
    problem = llm.ContactProblem(
        ufl.inner(flux(ufl.grad(u)), ufl.grad(w)) * ufl.dx,
        -ufl.inner(flux(mean), ufl.grad(w)) * ufl.dx,
        bcs=[fem.dirichletbc(fem.Function(V), middle)],
        interfaces=ties,
        **chosen,
    )
    return problem, modulus, mean, flux
