"""Seconds of stages."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

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


class Timer:
    """Logs the seconds of a stage, and hands them on.

    Args:
        stage: its name.
        add: takes name and seconds.
    """

    def __init__(self, stage: str, add: Callable[[str, float], None]) -> None:
        self.stage, self._add = stage, add

    def __enter__(self) -> None:
        self.start = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        seconds = time.perf_counter() - self.start
        log.info("%s: %.3g s", self.stage, seconds)
        self._add(self.stage, seconds)
