"""What a problem goes on from, as a file: saved and read again, also by other numbers of ranks.

What interfaces keep is the same on every rank. Values at the bodies' nodes stand by the cells of
the mesh as it was read or made, which do not depend on the number of ranks.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from dolfinx import fem

from dolfinx_llm.base import compat
from dolfinx_llm.base.disposable import Disposable
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import agree, collective
from dolfinx_llm.contact.results import collect_results
from dolfinx_llm.contact.state import ContactState
from dolfinx_llm.output.writing import writable_file, writing

FORMAT = "dolfinx_llm state 1"
SAME_PLACES = 1e-9  # of their size: by how much nodes of the interfaces may differ
Arrays = dict[str, np.ndarray]


class Saving(Disposable):
    """Problems whose state can be saved and read again."""

    def save(self, file: str | Path) -> None:
        """Write the state of the last step: displacement, contact, and what laws keep. An older
        file is replaced once the new one is whole. Collective.

        Args:
            file: to write, ending on .npz.

        Raises:
            ContactInputError: a path that cannot be written, or a problem that cannot be saved.
            ContactError: nothing has been solved.
        """
        common, local = self.state_arrays()
        spaces, given = self.saved_spaces(), {"format": np.array(FORMAT)} | common
        for name, values in local.items():
            for i, table in enumerate(_by_cells(spaces, values)):
                given[f"body {i} {name}"] = table
        with collective(self.comm):
            path = writable_file("file", file, (".npz",))
        with collective(self.comm):
            if self.comm.rank == 0:
                _write(path, given)

    def load(self, file: str | Path) -> None:
        """Go on from a state that ``save`` wrote for the same scene, on any number of ranks.
        Collective.

        Args:
            file: to read.

        Raises:
            ContactInputError: not a file of ``save``, or of another scene.
        """
        with collective(self.comm):
            found = _read(file) if self.comm.rank == 0 else {}
        found = self.comm.bcast(found)
        spaces, local = self.saved_spaces(), {}
        agree(self.comm, "file", str(file))
        with collective(self.comm):
            for name in {key.split(" ", 2)[2] for key in found if key.startswith("body ")}:
                tables = [found.get(f"body {i} {name}") for i in range(len(spaces))]
                local[name] = _from_cells(spaces, tables, file)
            self._check_scene(found, file)
        self.take_arrays(found, local)

    def saved_spaces(self) -> Sequence[Any]:
        """Spaces of the bodies' dofs."""
        raise NotImplementedError

    def state_arrays(self) -> tuple[Arrays, Arrays]:
        """What is the same on every rank, and this rank's values of the bodies' dofs."""
        raise NotImplementedError

    def take_arrays(self, common: Arrays, local: Arrays) -> None:
        """Go on from what ``state_arrays`` returned; collective.

        Args:
            common, local: as it returned them.
        """
        raise NotImplementedError

    def _check_scene(self, common: Arrays, file: Any) -> None:
        """Require a state of this scene."""
        mine, theirs = self.places(), common.get("places", np.zeros(0))
        size = np.abs(mine).max(initial=0.0)
        same = mine.shape == theirs.shape
        if not same or np.abs(mine - theirs).max(initial=0.0) > SAME_PLACES * size:
            raise _other_scene(file, "interfaces at other places")

    def places(self) -> np.ndarray:
        """What tells this scene from others."""
        raise NotImplementedError


class SavedContact(Saving):
    """Saving of ``ContactProblem``."""

    method: Any
    bulk: Any
    operators: Any

    def saved_spaces(self) -> Sequence[Any]:
        """Spaces of the bodies' dofs.

        Raises:
            ContactInputError: a mixed space.
        """
        if self.bulk.dofs.others:
            raise ContactInputError("problems of mixed spaces cannot be saved yet")
        return self.bulk.dofs.spaces

    def places(self) -> np.ndarray:
        """Places of the interfaces, which tell this scene from others."""
        return np.concatenate([p.x for p in self.operators.pairs])

    def state_arrays(self) -> tuple[Arrays, Arrays]:
        """What is the same on every rank, and this rank's values at the bodies' dofs."""
        common, local = self.method.kept()
        common |= {"places": self.places(), "history": np.array(json.dumps(self.method.history))}
        for i, state in enumerate(self.method.states):
            own = {f.name: getattr(state.own, f.name) for f in fields(ContactState)}
            kept = own.pop("history")
            common |= {f"interface {i} {name}": value for name, value in own.items()}
            common |= {f"interface {i} law {name}": value for name, value in kept.items()}
        return common, local

    def take_arrays(self, common: Arrays, local: Arrays) -> None:
        """Go on from what ``state_arrays`` returned; collective.

        Args:
            common, local: as it returned them.
        """
        self.update()
        self.method.take(common, local)
        for i, state in enumerate(self.method.states):
            start, law = f"interface {i} ", f"interface {i} law "
            names = [f.name for f in fields(ContactState) if f.name != "history"]
            own = {name: common[start + name] for name in names}
            kept = {key[len(law) :]: v for key, v in common.items() if key.startswith(law)}
            state.restore(ContactState(**own, history=kept))
        self.method.iteration.history = json.loads(str(common["history"]))
        self.history = self.method.history
        multiplier, v = common["reported"], common["w"][: len(common["loads"])]
        self.results = collect_results(
            self.operators, local["u"], multiplier, v, self.method.states
        )
        self._u = self.bulk.functions(local["u"])

    def update(self) -> None:
        """See ``ContactProblem``."""
        raise NotImplementedError


class SavedNonlinear(Saving):
    """Saving of ``NonlinearContactProblem``; results are known again after the next ``solve``."""

    bulk: Any
    _state: Any
    _newton: Any

    def saved_spaces(self) -> Sequence[Any]:
        """Spaces of the bodies' dofs."""
        return self.bulk.dofs.spaces

    def places(self) -> np.ndarray:
        """Places of the interfaces, which tell this scene from others."""
        drawn = [placed.drawn for placed in self._newton.equations.interfaces]
        return np.concatenate([np.zeros(0), *drawn])

    def state_arrays(self) -> tuple[Arrays, Arrays]:
        """What is the same on every rank, and this rank's values at the bodies' dofs.

        Raises:
            ContactInputError: laws of your own.
        """
        state, common = self._state, {"places": self.places(), "pressures": self._state.pressures}
        if any(kept is not None for kept in state.kept):
            raise ContactInputError(
                "laws of your own at finite deformation cannot be saved yet: save your own data"
            )
        for i, (own, pose) in enumerate(zip(state.own, state.poses, strict=True)):
            common |= {f"interface {i} own": own, f"interface {i} pose": pose}
            if state.status[i] is not None:
                common[f"interface {i} status"] = state.status[i]
        return common, {"u": state.u, "pushed": state.pushed}

    def take_arrays(self, common: Arrays, local: Arrays) -> None:
        """Go on from what ``state_arrays`` returned; collective.

        Args:
            common, local: as it returned them.
        """
        count = range(len(self._state.own))
        self._state = replace(
            self._state,
            u=local["u"],
            own=tuple(common[f"interface {i} own"] for i in count),
            status=tuple(common.get(f"interface {i} status") for i in count),
            pressures=common["pressures"],
            poses=tuple(common[f"interface {i} pose"] for i in count),
            pushed=local["pushed"],
        )
        self.bulk.put(local["u"])


def _by_cells(spaces: Sequence[Any], values: np.ndarray) -> list[np.ndarray]:
    """Per mesh (cells, nodes, gdim) of this rank's values, on rank 0; collective."""
    found, start = [], 0
    for V in spaces:
        function = fem.Function(V)
        gdim = V.mesh.geometry.dim
        count = V.dofmap.index_map.size_local * gdim
        function.x.array[:count] = values[start : start + count]
        function.x.scatter_forward()
        start += count
        cells, own = _cells(V), V.mesh.topology.index_map(V.mesh.topology.dim).size_local
        table = function.x.array.reshape(-1, gdim)[compat.cell_dofs(V)[:own]]
        parts = V.mesh.comm.gather((cells[:own], table))
        if parts is None:
            found.append(np.zeros(0))
            continue
        order = np.argsort(np.concatenate([part[0] for part in parts]))
        found.append(np.concatenate([part[1] for part in parts])[order])
    return found


def _from_cells(spaces: Sequence[Any], tables: Sequence[Any], file: Any) -> np.ndarray:
    """This rank's values of tables per mesh."""
    found = []
    for V, table in zip(spaces, tables, strict=True):
        cells, dofs = _cells(V), compat.cell_dofs(V)
        count = V.mesh.topology.index_map(V.mesh.topology.dim).size_global
        if table is None or table.shape != (count, dofs.shape[1], V.mesh.geometry.dim):
            raise _other_scene(file, "meshes of other sizes")
        index_map = V.dofmap.index_map
        values = np.zeros((index_map.size_local + index_map.num_ghosts, table.shape[2]))
        values[dofs[: len(cells)]] = table[cells]
        found.append(values[: index_map.size_local].ravel())
    return np.concatenate(found)


def _cells(V: Any) -> np.ndarray:
    """Numbers that this rank's cells had when the mesh was read or made."""
    return np.asarray(V.mesh.topology.original_cell_index)


def _other_scene(file: Any, what: str) -> ContactInputError:
    return ContactInputError(f"{file} was saved of another scene: it has {what}")


def _write(path: Path, arrays: Arrays) -> None:
    """Write a file beside the old one, and put it in its place."""
    new = path.with_name(f".{path.name}.{os.getpid()}.new")
    try:
        with writing(path):
            with open(new, "wb") as stream:
                np.savez(stream, **arrays)
            os.replace(new, path)
    finally:
        new.unlink(missing_ok=True)


def _read(file: Any) -> Arrays:
    try:
        with np.load(file, allow_pickle=False) as stored:
            found = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, TypeError, AttributeError, BadZipFile) as error:
        words = " ".join(str(error).split())[:200]
        raise ContactInputError(f"{file} is no file that save() wrote: {words}") from error
    if str(found.pop("format", "")) != FORMAT:
        raise ContactInputError(
            f"{file} is no file that this version's save() wrote: give one that it has written"
        )
    return found
