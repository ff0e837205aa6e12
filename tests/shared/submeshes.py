"""Two bodies on submeshes of one mesh, and the maps between them."""

import inspect

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scenes import NU, E, grid

import dolfinx_llm as llm
from dolfinx_llm import compat

MAPPED = "entity_maps" in inspect.signature(fem.form).parameters


class Halves:
    """Two blocks of triangles on submeshes of one mesh, with a modulus that varies on the parent.

    Args:
        where: "both" a form integrates over its submesh, with the parent's modulus; "parent" over
            the parent's cells; "own" with a modulus of the submesh.
    """

    def __init__(self, where, nonlinear=False, comm=MPI.COMM_SELF):
        x, quads = zip(grid(5, 3, high=(1.0, 0.5)), grid(4, 3, (0.0, 0.5)), strict=True)
        quads = np.concatenate([quads[0], quads[1] + len(x[0])])
        triangles = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
        x = np.concatenate(x)
        if comm.rank > 0:
            triangles, x = triangles[:0], x[:0]
        whole = compat.create_mesh(comm, triangles, x, "triangle")
        parent = self._modulus(whole)
        self.nonlinear, self.moduli = nonlinear, []
        self.forms, self.loads, self.u, self.bcs, sides, maps = [], [], [], [], [], []
        for level, tag in (0.0, 1), (1.0, 2):
            cells = np.sort(mesh.locate_entities(
                whole, 2, lambda x, low=tag == 1: x[1] < 0.5 + 1e-9 if low else x[1] > 0.5 - 1e-9
            ))  # fmt: skip
            sub, found = mesh.create_submesh(whole, 2, cells)[:2]
            maps.append((sub, cells, found))
            V = compat.function_space(sub, shape=(2,))
            modulus = self._modulus(sub) if where == "own" else parent
            self.moduli += [modulus] if modulus not in self.moduli else []
            dx = ufl.Measure("dx", domain=sub)
            if where == "parent":
                tags = mesh.meshtags(whole, 2, cells, np.ones(len(cells), dtype=np.int32))
                dx = ufl.Measure("dx", domain=whole, subdomain_data=tags)(1)
            self._add(V, modulus, dx)
            dofs = fem.locate_dofs_geometrical(V, lambda x, y=level: np.isclose(x[1], y))
            held = np.array([0.0, -0.02 * level])
            self.bcs.append(fem.dirichletbc(held, dofs, V))
            sub.topology.create_connectivity(1, 2)
            at = np.sort(mesh.locate_entities_boundary(sub, 1, lambda x: np.isclose(x[1], 0.5)))
            sides.append((mesh.meshtags(sub, 1, at, np.full(len(at), tag, dtype=np.int32)), tag))
        self.interface = llm.Interface(None, tuple(sides), law=llm.Coulomb(0.2))
        self.entity_maps = None if where == "own" else self._maps(whole, maps, where)

    def _modulus(self, domain):
        modulus = fem.Function(compat.function_space(domain, "DG", 0))
        modulus.interpolate(lambda x: E * (1.0 + x[0] + 2.0 * x[1]))
        return modulus

    def _add(self, V, modulus, dx):
        u, v = fem.Function(V), ufl.TestFunction(V)
        force = ufl.inner(fem.Constant(V.mesh, (5.0, 0.0)), v) * dx
        self.u.append(u)
        self.loads.append(force)
        if self.nonlinear:
            F = ufl.Identity(2) + ufl.grad(u)
            energy = ufl.inner(F, F) - 2.0 - 2.0 * ufl.ln(ufl.det(F)) + ufl.ln(ufl.det(F)) ** 2
            self.forms.append(ufl.derivative(modulus / 4 * energy * dx, u, v) - force)
        else:
            w = ufl.TrialFunction(V)
            eps = ufl.sym(ufl.grad(w))
            sigma = modulus / (1 + NU) * (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(2))
            self.forms.append(ufl.inner(sigma, ufl.grad(v)) * dx)

    def _maps(self, whole, maps, where):
        """In the syntax of this dolfinx."""
        if hasattr(mesh, "EntityMap"):
            return [found for _, _, found in maps]
        count = whole.topology.index_map(2).size_local
        if where == "both":  # of each form the parent's cells
            return [{whole: found} for _, _, found in maps]
        inverse = {sub: np.full(count, -1, dtype=np.int32) for sub, _, _ in maps}
        for sub, cells, _ in maps:
            inverse[sub][cells] = np.arange(len(cells))
        return inverse

    def problem(self):
        """In contact."""
        options = {"bcs": self.bcs, "interfaces": self.interface, "entity_maps": self.entity_maps}
        if self.nonlinear:
            return llm.NonlinearContactProblem(self.forms, self.u, **options)
        return llm.ContactProblem(self.forms, self.loads, **options)
