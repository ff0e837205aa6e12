"""States carried over to other meshes, as JSON: a dragged block, its friction there and a step
later; a block of distorted quadrilaterals on a plane, in which far points have no reference."""

import json

import friction_block
import numpy as np
import scenes
from dolfinx import mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_WORLD


def jittered(n, seed):
    """The problem of a block that is sheared on a plane."""
    x, quads = scenes.grid(n, n, jitter=0.3, seed=seed)
    own = None if COMM.rank == 0 else 0
    domain = compat.create_mesh(COMM, quads[:own, [0, 1, 3, 2]], x[:own], "quadrilateral")
    bottom = mesh.locate_entities_boundary(domain, 1, scenes.on(1, 0.0))
    tags = scenes.tags_from(domain, [bottom], [np.full(len(bottom), 1, dtype=np.int32)], 1)
    V = compat.function_space(domain, shape=(2,))
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    interface = llm.Interface(tags, (1, plane), law=llm.Coulomb(0.5))
    top = ((0, scenes.on(1, 1.0)), (1, scenes.on(1, 1.0)))
    bcs = scenes.hold(V, top, lambda p: np.array([[0.001], [-0.01]]) + 0.0 * p[:2])
    return llm.ContactProblem(*scenes.forms(V), bcs=bcs, interfaces=[interface])


old, new = (friction_block.Dragged(0.3, elements) for elements in ((6, 9), (8, 11)))
for way in (0.0, 0.0005):
    old.top.g.x.array[:] = way
    old.problem.solve()
llm.transfer(old.problem, new.problem)
found = [new.problem.results[0].resultant.tolist()]
new.top.g.x.array[:] = 0.0008
new.problem.solve()
found.append(new.problem.results[0].resultant.tolist())
old, new = jittered(9, 1), jittered(11, 2)
old.solve()
llm.transfer(old, new)
sheared = new.u.x.array.reshape(-1, 2)[: new.u.function_space.dofmap.index_map.size_local]
found.append(COMM.allreduce(np.square(sheared).sum(axis=0)).tolist())
if COMM.rank == 0:
    print(json.dumps({"found": found}))
