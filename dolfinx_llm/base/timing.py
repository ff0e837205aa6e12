"""Seconds of stages."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping

log = logging.getLogger("dolfinx_llm")


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

    def timed(self, stage: str) -> Timer:
        """What adds the seconds of a ``with`` block to those of a stage, and logs them."""
        return Timer(stage, self)

    def add(self, times: Mapping[str, float]) -> None:
        """Add seconds of stages."""
        for stage, seconds in times.items():
            self[stage] = self.get(stage, 0.0) + seconds


class Timer:
    """Logs the seconds of a stage, and adds them up."""

    def __init__(self, stage: str, times: StageTimes) -> None:
        self.stage, self._times = stage, times

    def __enter__(self) -> None:
        self._times.inside.append(0.0)
        self.start = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        seconds = time.perf_counter() - self.start
        own = seconds - self._times.inside.pop()
        self._times.inside[-1] += seconds
        log.info("%s: %.3g s", self.stage, own)
        self._times.add({self.stage: own})
