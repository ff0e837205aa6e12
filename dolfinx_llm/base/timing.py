"""Seconds of stages."""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from dolfinx_llm.base.log import log


class Clock:
    """Seconds of stages that follow each other."""

    def __init__(self) -> None:
        self.times: dict[str, float] = {}
        self._last = time.perf_counter()

    def stop(self, stage: str) -> None:
        now = time.perf_counter()
        self.times[stage] = self.times.get(stage, 0.0) + now - self._last
        self._last = now


class StageTimes(dict[str, float]):
    """Seconds per stage, summed up; those of a stage inside of another count for itself alone."""

    def __init__(self) -> None:
        super().__init__()
        self.inside = [0.0]  # seconds of stages that have ended within each that goes on

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the seconds of a ``with`` block to those of a stage, and log them."""
        self.inside.append(0.0)
        start = time.perf_counter()
        try:
            yield
        finally:
            seconds = time.perf_counter() - start
            own = seconds - self.inside.pop()
            self.inside[-1] += seconds
            log.info("%s: %.3g s", stage, own)
            self.add({stage: own})

    def add(self, times: Mapping[str, float]) -> None:
        """Add seconds of stages."""
        for stage, seconds in times.items():
            self[stage] = self.get(stage, 0.0) + seconds
