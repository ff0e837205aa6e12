"""What stands in the place of something that has been destroyed."""

from __future__ import annotations

from typing import Any, NoReturn

from dolfinx_llm.base.errors import ContactError


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
