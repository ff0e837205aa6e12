"""Gathering of interface-sized data and errors that all ranks raise together."""

import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from mpi4py import MPI

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError


def gather_rows(comm: MPI.Comm, rows: Array) -> Array:
    """The rows (n_local, ...) of all ranks on every rank, in rank order."""
    return np.concatenate(comm.allgather(rows)) if comm.size > 1 else rows


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
    """Require that an argument, plain data, is the same on all ranks: ``ContactInputError`` on
    all."""
    if comm.size == 1:
        return
    texts = comm.allgather(repr(value))
    if any(text != texts[0] for text in texts):
        other = next(i for i, text in enumerate(texts) if text != texts[0])
        raise ContactInputError(
            f"{what} must be the same on all ranks: rank 0 has {texts[0][:80]}, rank {other} has "
            f"{texts[other][:80]}"
        )
