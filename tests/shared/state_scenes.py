"""Interfaces on meshes of several sizes: flat, and against an obstacle."""

from mpi4py import MPI
from scenes import grid, stacked

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.interface.build import build_interface


def flat(law, n=4):
    sections = [grid(n, n, high=(1.5, 1.5), jitter=0.1), grid(5, 6, (0.2, 0.3), (1.1, 1.2), 0.1, 8)]
    domain, tags = stacked(MPI.COMM_SELF, sections, (0.0, 1.0, 2.0))
    return domain, llm.Interface(tags, (2, 3), law=law)


def obstacle(law, n=4):
    domain, tags = stacked(MPI.COMM_SELF, [grid(3, n, jitter=0.1)], (0.1, 1.0))
    return domain, llm.Interface(tags, (1, llm.RigidPlane((0, 0, 0), (0, 0, 1))), law=law)


def geometry_of(scene, law, n=4):
    domain, interface = scene(law, n)
    gdim = domain.geometry.dim
    return build_interface(interface, [compat.function_space(domain, shape=(gdim,))])
