"""Interfaces whose bodies may be moved: flat, curved, against an obstacle."""

import numpy as np
from curved_scenes import FACE_0, FACE_1, rings
from mpi4py import MPI
from scenes import grid, stacked

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.interface.build import build_interface


def flat(law):
    sections = [grid(4, 4, high=(1.5, 1.5), jitter=0.1), grid(5, 6, (0.2, 0.3), (1.1, 1.2), 0.1, 8)]
    domain, tags = stacked(MPI.COMM_SELF, sections, (0.0, 1.0, 2.0))
    return domain, llm.Interface(tags, (2, 3), law=law)


def curved(law):
    V, tags = rings(MPI.COMM_SELF, ((8, 2), (11, 2)))
    return V.mesh, llm.Interface(tags, (FACE_0, FACE_1), law=law)


def obstacle(law):
    domain, tags = stacked(MPI.COMM_SELF, [grid(3, 4, jitter=0.1)], (0.1, 1.0))
    return domain, llm.Interface(tags, (1, llm.RigidPlane((0, 0, 0), (0, 0, 1))), law=law)


def geometry_of(scene, law):
    domain, interface = scene(law)
    gdim = domain.geometry.dim
    return build_interface(interface, [compat.function_space(domain, shape=(gdim,))])


def at_rest(geometry):
    v = None if geometry.frame is None else np.zeros_like(geometry.frame.x)
    return [np.zeros_like(side.x) for side in geometry.site.whole], v
