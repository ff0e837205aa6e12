"""Objects that hold PETSc's, and what becomes of these."""

import sys
from types import TracebackType
from typing import Any, NoReturn, Self

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.log import log


class Disposable:
    """Frees its PETSc objects in ``destroy``, at the end of a ``with`` block, or, on one rank, when
    nobody refers to it any more."""

    comm: MPI.Comm

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # Other errors may have ended the block on this rank alone.
        if error is None or isinstance(error, ContactError) or self.comm.size == 1:
            self.destroy()


class Remains:
    """The last attribute of an object: when that goes, so does, on one rank, what PETSc has left on
    the communicators of its meshes. petsc4py frees what is shared between ranks only where all of
    them ask for it together."""

    dropped = 0  # objects that went without ``destroy`` on several ranks
    told = False  # that this costs memory

    def __init__(self, meshes: list[Any]) -> None:
        self._meshes, self.destroyed = meshes, False

    def __del__(self) -> None:
        if sys.is_finalizing() or self.destroyed:
            return
        if MPI.COMM_WORLD.size > 1:
            Remains.dropped += 1
            return
        for mesh in self._meshes:
            free_garbage(mesh.comm)


def free_garbage(comm: MPI.Comm) -> None:
    """Free PETSc objects that no rank refers to any more; collective. On several ranks a warning
    says, once, where this had been left to the garbage collector."""
    if not hasattr(PETSc, "garbage_cleanup") or PETSc.Sys.isFinalized():
        return
    PETSc.garbage_cleanup(comm)
    if comm.size == MPI.COMM_WORLD.size:
        PETSc.garbage_cleanup(MPI.COMM_WORLD)
    if comm.size > 1 and Remains.dropped and not Remains.told:
        Remains.told = True
        if comm.rank == 0:
            log.warning(
                "a ContactProblem was dropped without destroy(): on several ranks its memory stays "
                "taken. Call destroy() when done with each, or write `with ContactProblem(...) as "
                "problem:`"
            )


class Destroyed:
    """Whose use, in any way, is a ``ContactError`` that names the owner."""

    def __init__(self, owner: str) -> None:
        self.owner = owner

    def _refuse(self, *_: Any) -> NoReturn:
        raise ContactError(
            f"{self.owner} has been destroyed: take what is needed of it before destroy(), or make "
            "a new one"
        )

    __getattr__ = __getitem__ = __iter__ = __len__ = __bool__ = __call__ = _refuse
