"""What a problem goes on from, as a file: saved and read again, also by other numbers of ranks.

What interfaces keep is the same on every rank; ``state_file`` has the values at bodies' nodes.
"""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.disposable import Disposable
from dolfinx_llm.base.parallel import agree, collective
from dolfinx_llm.contact.equations.state import ContactState
from dolfinx_llm.contact.results.of_interfaces import Results
from dolfinx_llm.contact.results.results import collect_results
from dolfinx_llm.finite.own_laws.law_told import Kept
from dolfinx_llm.finite.results import MovingInterfaceResult
from dolfinx_llm.output.writing import writable_file
from dolfinx_llm.problem.saved_results import arrays_of, result_of
from dolfinx_llm.problem.state_file import (
    FORMAT,
    Arrays,
    by_cells,
    check_order,
    from_cells,
    other_scene,
    read_state,
    write_state,
)

AS_FORCES = "f", "pushed", "inertia"  # of the bodies' dofs: what is saved that is no displacement
SAME_PLACES = 1e-9  # of their size: by how much nodes of the interfaces may differ


class Saving(Disposable):
    """Problems whose state can be saved and read again."""

    interfaces: Any
    bulk: Any

    def save(self, file: str | Path) -> None:
        """Write the state of the last step: displacement, contact, and what laws keep. An older
        file is replaced once the new one is whole. Collective.

        Args:
            file: to write, ending on .npz.

        Raises:
            ContactInputError: a path that cannot be written, or a problem that cannot be saved.
            ContactError: nothing has been solved.
        """
        with collective(self.comm):
            check_order(self.saved_bulk.blocks)
        common, local = self.state_arrays()
        blocks, told = self.saved_bulk.blocks, {"format": FORMAT, "kind": self._kind()}
        given = {name: np.array(text) for name, text in told.items()} | common
        for name, values in local.items():
            for i, table in enumerate(by_cells(blocks, values / self._unit(name))):
                given[f"body {i} {name}"] = table
        with collective(self.comm):
            path = writable_file("file", file, (".npz",))
        with collective(self.comm):
            if self.comm.rank == 0:
                write_state(path, given)

    def load(self, file: str | Path) -> None:
        """Go on from a state that ``save`` wrote for the same scene, on any number of ranks.
        Collective.

        Args:
            file: to read.

        Raises:
            ContactInputError: not a file of ``save``, or of another scene.
        """
        agree(self.comm, "file", str(file))
        with collective(self.comm):
            found = read_state(file) if self.comm.rank == 0 else {}
        tables = {key: found.pop(key) for key in list(found) if key.startswith("body ")}
        names = sorted({key.split(" ", 2)[2] for key in tables})
        common, names = self.comm.bcast((found, names))
        self.update()
        with collective(self.comm):
            self._check_scene(common, file)
        blocks, local = self.saved_bulk.blocks, {}
        for name in names:
            own = [tables.get(f"body {i} {name}") for i in range(len(blocks))]
            local[name] = from_cells(blocks, own, file) * self._unit(name)
        self.take_arrays(common, local)

    @property
    def saved_bulk(self) -> Any:
        """What assembles the bodies."""
        return self.bulk

    def _unit(self, name: str) -> Array:
        """(n_local,) by which units of an array of ``state_arrays`` differ from displacements': in
        mixed spaces a force's is their inverse."""
        if name not in AS_FORCES:
            return np.ones(len(self.saved_bulk.dofs.fixed))
        unit = np.concatenate([block.scale for block in self.saved_bulk.blocks]) ** 2
        # Loads have the prescribed values where there are some.
        return np.where(self.saved_bulk.dofs.fixed & (name == "f"), 1.0, unit)

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
        if str(common["kind"]) != self._kind():
            raise other_scene(file, f"{common['kind']}, and this one {self._kind()}")
        mine, theirs = self.places(), common["places"]
        size = np.abs(mine).max(initial=0.0)
        same = mine.shape == theirs.shape
        if not same or np.abs(mine - theirs).max(initial=0.0) > SAME_PLACES * size:
            raise other_scene(file, "interfaces at other places")

    def _kind(self) -> str:
        """Kinds of problem and laws, whose values may change, and which surfaces supports lead."""
        kinds = [type(one).__name__ for one in (self, *(i.law for i in self.interfaces))]
        for i, side in enumerate(self.led()):
            if side is not None:
                kinds[i + 1] += f" with side {side} led by supports"
        return ", ".join(kinds)

    def led(self) -> list[int | None]:
        """Per interface the side that supports lead as a whole, if there is one."""
        raise NotImplementedError

    def update(self) -> None:
        """See ``ContactProblem``."""
        raise NotImplementedError

    def places(self) -> Array:
        """What tells this scene from others."""
        raise NotImplementedError


class SavedContact(Saving):
    """Saving of ``ContactProblem``."""

    method: Any
    operators: Any

    def places(self) -> Array:
        """Places of the interfaces, which tell this scene from others."""
        return np.concatenate([p.x for p in self.operators.pairs])

    def led(self) -> list[int | None]:
        return [geometry.site.prescribed for geometry in self.operators.geometries]

    def state_arrays(self) -> tuple[Arrays, Arrays]:
        common, local = self.method.kept()
        common |= {"places": self.places(), "history": np.array(json.dumps(self.method.history))}
        for i, state in enumerate(self.method.states):
            own = vars(state.own.copy())
            kept = own.pop("history")
            told = {name: value for name, value in own.items() if value is not None}
            common |= {f"interface {i} {name}": value for name, value in told.items()}
            common |= {f"interface {i} law {name}": value for name, value in kept.items()}
        return common, local

    def take_arrays(self, common: Arrays, local: Arrays) -> None:
        self.update()
        self.method.take(common, local)
        for i, state in enumerate(self.method.states):
            start, law = f"interface {i} ", f"interface {i} law "
            names = [f.name for f in fields(ContactState) if f.name != "history"]
            own: dict[str, Any] = {name: common.get(start + name) for name in names}
            kept = {key[len(law) :]: v for key, v in common.items() if key.startswith(law)}
            state.forget()
            state.restore(ContactState(**own, history=state.own.history | kept))
        self.method.iteration.history = json.loads(str(common["history"]))
        self.history = self.method.history
        multiplier, v = common["reported"], common["w"][: len(common["loads"])]
        self.results = collect_results(
            self.operators, local["u"], multiplier, v, self.method.states
        )
        self._u = self.bulk.functions(local["u"])


class SavedNonlinear(Saving):
    """Saving of ``NonlinearContactProblem``."""

    results: list[MovingInterfaceResult]
    _state: Any
    _newton: Any

    def places(self) -> Array:
        """Places of the interfaces, which tell this scene from others."""
        every = [placed.what.sides.surfaces for placed in self._newton.equations.interfaces]
        drawn = [(s.x + s.origin).ravel() for surfaces in every for s in surfaces]
        return np.concatenate([np.zeros(0), *drawn])

    def led(self) -> list[int | None]:
        return [placed.led for placed in self._newton.equations.interfaces]

    @property
    def keeps(self) -> bool:
        """Whether laws of your own have kept something."""
        return any(kept is not None for kept in self._state.kept)

    def state_arrays(self) -> tuple[Arrays, Arrays]:
        """What is the same on every rank, also what laws of your own have kept, and this rank's
        values at the bodies' dofs."""
        state, common = self._state, {"places": self.places(), "pressures": self._state.pressures}
        for i, (own, pose) in enumerate(zip(state.own, state.poses, strict=True)):
            common |= {f"interface {i} own": own, f"interface {i} pose": pose}
            if state.status[i] is not None:
                common[f"interface {i} status"] = state.status[i]
            if state.kept[i] is not None:
                common |= state.kept[i].arrays(f"interface {i} law ")
        for i, result in enumerate(self.results):
            own = arrays_of(result)
            common |= {f"interface {i} result {name}": value for name, value in own.items()}
        return common, {"u": state.u, "pushed": state.pushed}

    def take_arrays(self, common: Arrays, local: Arrays) -> None:
        self.update()
        count = range(len(self._state.own))
        self._state = replace(
            self._state,
            u=local["u"],
            own=tuple(common[f"interface {i} own"] for i in count),
            status=tuple(common.get(f"interface {i} status") for i in count),
            pressures=common["pressures"],
            poses=tuple(common[f"interface {i} pose"] for i in count),
            pushed=local["pushed"],
            kept=tuple(Kept.read(common, f"interface {i} law ") for i in count),
        )
        self.results = Results()
        for start in (f"interface {i} result " for i in count):
            own = {key[len(start) :]: a for key, a in common.items() if key.startswith(start)}
            self.results += [result_of(own)] if own else []
        self.bulk.put(local["u"])
