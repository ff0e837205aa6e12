"""What long stages tell: lines of the logger "dolfinx_llm", and progress on a terminal.

``logging.basicConfig(level=logging.INFO)`` in a script shows stages, interfaces and every iteration
of the contact laws. All ranks do the same, so that lines of this level come from rank 0 alone;
warnings and ``DEBUG`` come from all. Records carry their rank as ``%(rank)d``.
"""

import logging
import re
from collections.abc import Iterable, Sequence
from typing import Any

from mpi4py import MPI
from tqdm import tqdm

WORLD_RANK, WORLD_SIZE = MPI.COMM_WORLD.rank, MPI.COMM_WORLD.size

log = logging.getLogger("dolfinx_llm")


class RankFilter(logging.Filter):
    """Adds the rank to records, and drops those of level INFO on all ranks but the first."""

    def filter(self, record: logging.LogRecord) -> bool:
        record.rank = WORLD_RANK
        if WORLD_SIZE > 1:
            record.msg = f"[rank {WORLD_RANK}] {record.msg}"
        return WORLD_RANK == 0 or record.levelno != logging.INFO


log.addFilter(RankFilter())


def warn(comm: MPI.Comm, told: Sequence[str], before: Sequence[str]) -> None:
    """Log what is told of a load step as warnings, and at level INFO what was told of the last one
    as well, with whatever numbers, as of a clearance that has not closed yet.

    Args:
        comm: of the bodies; its first rank tells.
        told, before: of this load step and the last, "what: words".
    """
    known = {_without_numbers(words) for words in before}
    for words in told if comm.rank == 0 else ():
        log.log(logging.INFO if _without_numbers(words) in known else logging.WARNING, words)


def warn_of(name: str, text: str, notes: list[str]) -> None:
    """Warn of an interface, and keep the text among its notes, which ``print(problem)`` shows."""
    log.warning("interface %s: %s", name, text)
    notes.append(text)


def _without_numbers(words: str) -> str:
    """Words with the numbers after their head left out."""
    head, colon, rest = words.partition(": ")
    return head + colon + re.sub(r"[-+]?[\d.]+(e[-+]?\d+)?", "", rest)


def progress(steps: Iterable[Any] | None, stage: str) -> tqdm:
    """The steps of a stage, with a line on rank 0 while it lasts if stderr is a terminal and the
    log does not tell of it; without steps the caller counts, with ``update()``."""
    quiet = True if WORLD_RANK or log.isEnabledFor(logging.INFO) else None
    return tqdm(steps, desc=stage, leave=False, disable=quiet)


def tell_iteration(entry: dict[str, Any], bar: tqdm | None) -> None:
    """Log an entry of ``ContactProblem.history``, or show it on the progress line."""
    text = "{active} in contact, {stick} stick, {slip} slip, {changes} changes, residual "
    text = text.format(**entry) + f"{entry['residual']:.1e}"
    log.info("contact law, iteration %d: %s", entry["iteration"], text)
    if bar is not None:
        bar.set_postfix_str(text, refresh=False)
        bar.update()
