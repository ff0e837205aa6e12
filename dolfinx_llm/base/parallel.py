"""Gathering of interface-sized data and errors that all ranks raise together."""

import io
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar, cast

import numpy as np
from mpi4py import MPI

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError

ROUNDED_APART = 1e-12  # by which numbers that ranks compute alike may differ
WRITABLE = 4  # protocol of pickle: from 5 on arrays that cannot be written to stay so

Found = TypeVar("Found")


def gather_rows(comm: MPI.Comm, rows: Array) -> Array:
    """The rows (n_local, ...) of all ranks on every rank, in rank order."""
    return np.concatenate(comm.allgather(rows)) if comm.size > 1 else rows


def told(comm: MPI.Comm, value: Found) -> Found:
    """The value of rank 0 on all ranks: what each computes alike differs by rounding."""
    return comm.bcast(value) if comm.size > 1 else value


def copied(comm: MPI.Comm, value: Found) -> Found:
    """A copy of the value of rank 0 on all ranks, with arrays of its own."""
    return cast(Found, pickle.loads(told(comm, pickle.dumps(value, WRITABLE))))


def chosen(comm: MPI.Comm, choose: Callable[[], Found], given: Any = None) -> Found:
    """What ``choose``, local work on data that all ranks have, returns on rank 0, for all of them.

    For whatever rounding decides: pivots, bases of null spaces, who comes first of equals. LAPACK
    rounds otherwise from processor to processor, and on one with where arrays lie in memory.

    Args:
        comm, choose: as told.
        given: what a user gave on all ranks and stays each one's own in what is found: functions
            written in place, as lambdas, cannot be sent.
    """
    if comm.size == 1:
        return choose()
    found: Any = None
    with collective(comm):
        if comm.rank == 0:
            found = choose()
    sent = io.BytesIO()
    if comm.rank == 0:
        _Sender(sent, given).dump(found)
    return cast(Found, _Receiver(io.BytesIO(told(comm, sent.getvalue())), given).load())


class _Sender(pickle.Pickler):
    """Leaves out what all ranks have been given."""

    def __init__(self, to: io.BytesIO, given: Any):
        super().__init__(to, pickle.HIGHEST_PROTOCOL)
        self.given = given

    def persistent_id(self, item: Any) -> str | None:
        return "given" if item is self.given and callable(item) else None


class _Receiver(pickle.Unpickler):
    """Puts in what this rank has been given."""

    def __init__(self, of: io.BytesIO, given: Any):
        super().__init__(of)
        self.given = given

    def persistent_load(self, name: str) -> Any:
        return self.given


@contextmanager
def collective(comm: MPI.Comm) -> Iterator[None]:
    """Run local work; where a rank fails, every rank raises the first failing rank's error.

    Leave no collective call inside: the ranks meet at the end of the block. This keeps an error
    on one rank from leaving the others waiting in the next collective call.
    """
    error = None
    try:
        yield
    except Exception as caught:
        error = caught
    if comm.size > 1:
        errors = comm.allgather(error and _sendable(error))
        first = next((rank for rank, e in enumerate(errors) if e is not None), comm.rank)
        error = error if first == comm.rank else errors[first]
    if error is not None:
        raise error


def _sendable(error: Exception) -> Exception:
    """An error that can be sent to other ranks: some cannot be pickled, or not be read again."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return ContactError(f"{type(error).__name__}: {error}")
    return error


def check(comm: MPI.Comm, failed: bool, message: str, kind: type[Exception] = ContactError) -> None:
    """Raise ``kind(message)`` on all ranks where ``failed`` holds on any of them."""
    texts = comm.allgather(message if failed else None) if comm.size > 1 else [failed and message]
    for text in texts:
        if text:
            raise kind(text)


def agree(comm: MPI.Comm, what: str, value: Any) -> None:
    """Require that an argument, plain data, is the same on all ranks, but for what rounding makes
    of it where each computes it: ``ContactInputError`` on all."""
    if comm.size == 1:
        return
    texts = comm.allgather(repr(value))
    if all(text == texts[0] for text in texts):
        return
    values = comm.allgather(value)
    other = next((i for i, found in enumerate(values) if not _alike(values[0], found)), None)
    if other is not None:
        first, second = _apart(values[0], values[other])
        raise ContactInputError(
            f"{what} must be the same on all ranks: rank 0 has {first!r:.80}, rank {other} has "
            f"{second!r:.80}"
        )


def _apart(a: Any, b: Any) -> tuple[Any, Any]:
    """The first items of two lists as long that differ, or what is no such lists."""
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        return next(pair for pair in zip(a, b) if not _alike(*pair))
    return a, b


def _alike(a: Any, b: Any) -> bool:
    """Whether numbers differ by rounding at most, of the largest that stand beside them, and all
    else is equal."""
    if not (isinstance(a, (list, tuple)) and type(a) is type(b) and len(a) == len(b)):
        return _alike([a], [b]) if isinstance(a, float) else repr(a) == repr(b)
    if all(isinstance(c, float) for c in (*a, *b)):
        size = max((abs(c) for c in (*a, *b)), default=0.0)
        return all(c == d or abs(c - d) <= ROUNDED_APART * size for c, d in zip(a, b, strict=True))
    return all(_alike(c, d) for c, d in zip(a, b, strict=True))
