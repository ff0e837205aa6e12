"""The list of results that a problem shows."""

from __future__ import annotations

from typing import Any

from dolfinx_llm.base.errors import ContactError


class Results(list[Any]):
    """Of the interfaces of a problem; empty while nothing is known of contact."""

    def __getitem__(self, at: Any) -> Any:
        if not self:
            raise ContactError("there are no results yet: call solve() first")
        return super().__getitem__(at)
