"""What annotations call an array, and what users may give in its place."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:  # with parameters, which Debian 12's NumPy asks for
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[Any]
else:
    Array = np.ndarray

Given: TypeAlias = Any  # numbers, a list or tuple of them, or an array, which is what is kept of it
