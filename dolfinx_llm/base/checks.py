"""Checks of arguments: what was given, and what is accepted, in one sentence.

Each returns the argument in the one type that is used from then on. Numbers of NumPy and arrays
without dimension are numbers; a bool is none. Texts are the same on every rank.
"""

import numbers
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError

T = TypeVar("T")
LITERALS = (str, bytes, bool, numbers.Number, np.ndarray, np.generic, Path, type(None))
LONGEST = 80  # characters of a value in a message


def shown(value: Any) -> str:
    """A value for messages: short, and without what differs between ranks, such as addresses.

    >>> shown("up"), shown((3, 7)), shown(np.zeros((2, 3))), shown([object()])
    ("'up'", '(3, 7)', 'an array of shape (2, 3)', '[object]')
    """
    if isinstance(value, np.ndarray) and value.size > 4:
        return f"an array of shape {value.shape}"
    if isinstance(value, type):
        text = f"class {value.__name__}"
    elif isinstance(value, (list, tuple)):
        inner = ", ".join(map(shown, value[:4])) + ", ..." * (len(value) > 4)
        text = f"[{inner}]" if isinstance(value, list) else f"({inner})"
        text = text.replace(")", ",)") if isinstance(value, tuple) and len(value) == 1 else text
    elif isinstance(value, LITERALS) or type(value).__module__.startswith("dolfinx_llm.laws"):
        text = " ".join(repr(value).split())
    else:
        text = type(value).__name__
    return text if len(text) <= LONGEST else text[: LONGEST - 4] + " ..."


def place(x: Array) -> list[Any]:
    """Coordinates for messages: six decimals, of small parts as many more as these need.

    >>> place(np.array([1.0, 1 / 3])), place(np.array([-1e-20, 1e-5 / 3]))
    ([1.0, 0.333333], [0.0, 3.333333e-06])
    """
    largest = float(np.abs(x).max(initial=0.0))
    digits = 6 if not largest > 0.0 else max(6, 6 - int(np.floor(np.log10(largest))))
    return list((np.round(x, min(digits, 300)) + 0.0).tolist())


def refuse(name: str, value: Any, accepted: str) -> NoReturn:
    """Raise ``ContactInputError`` for an argument; ``accepted`` goes on after "name=value: "."""
    raise ContactInputError(f"{name}={shown(value)}: {accepted}")


def _plain(value: Any) -> Any:
    """An array without dimension as its entry."""
    return value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value


def integer(
    name: str, value: Any, accepted: str = "give an integer", low: int | None = None
) -> int:
    """An integer of Python or NumPy, no bool, at least ``low``; ``accepted`` is for the message.

    >>> integer("tag", np.int32(3))
    3
    """
    plain = _plain(value)
    if isinstance(plain, bool) or not isinstance(plain, numbers.Integral):
        refuse(name, value, accepted)
    if low is not None and plain < low:
        refuse(name, value, accepted)
    return int(plain)


def number(
    name: str,
    value: Any,
    accepted: str = "give a finite number",
    low: float = -np.inf,
    above: float = -np.inf,
) -> float:
    """A finite real number, no bool, at least ``low`` and ``above`` its bound.

    >>> number("mu", np.float32(0.5), low=0.0)
    0.5
    """
    plain = _plain(value)
    if isinstance(plain, bool) or not isinstance(plain, numbers.Real):
        refuse(name, value, accepted)
    try:
        real = float(plain)
    except OverflowError:
        real = np.inf
    if not (np.isfinite(real) and real >= low and real > above):
        refuse(name, value, accepted)
    return real


def boolean(name: str, value: Any) -> bool:
    """True or False, and neither 0, 1 nor a string."""
    plain = _plain(value)
    if not isinstance(plain, (bool, np.bool_)):
        refuse(name, value, "give True or False")
    return bool(plain)


def one_of(name: str, value: T, choices: Sequence[T]) -> T:
    """One of several strings, or None where that is among the choices."""
    if not ((value is None or isinstance(value, str)) and value in choices):
        refuse(name, value, f"choose one of {tuple(choices)}")
    return value


def instance(name: str, value: Any, kind: type[T] | tuple[type[T], ...], accepted: str) -> T:
    """An object of a class, or of one of several."""
    if not isinstance(value, kind):
        refuse(name, value, accepted)
    return value


def items(name: str, value: Any, accepted: str) -> list[Any]:
    """The items of a list, a tuple or the like; of no string and no dict."""
    if isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.ndim == 1):
        return list(value)
    if isinstance(value, (str, bytes, dict, set, np.ndarray)) or not hasattr(value, "__iter__"):
        refuse(name, value, accepted)
    try:
        return list(value)
    except Exception:
        refuse(name, value, accepted)


def array(
    name: str, value: Any, shape: Sequence[int | None], accepted: str, integers: bool = False
) -> Array:
    """A finite array of a shape, in which None is any size: real numbers, or integers; no bool,
    nothing complex or ragged.

    >>> array("x", [[0, 1], [2, 3]], (None, 2), "give (n, 2) numbers").dtype.name
    'float64'
    """
    try:
        found = np.asarray(value)
    except Exception:
        refuse(name, value, accepted)
    empty = found.size == 0 and found.dtype.kind == "f"  # of lists without entries
    if found.dtype.kind not in ("iu" if integers else "iuf") and not (integers and empty):
        refuse(name, value, accepted)
    if found.ndim != len(shape) or any(
        n is not None and n != m for n, m in zip(shape, found.shape, strict=True)
    ):
        refuse(name, value, f"{accepted}, not of shape {found.shape}")
    bad = int((~np.isfinite(found)).sum())
    if bad:
        refuse(name, value, f"{accepted}; {bad} of them are not finite")
    return found.astype(np.int64 if integers else np.float64)


def path(name: str, value: Any) -> Path:
    """A path that is not empty, of a string or a ``Path``."""
    if not isinstance(value, (str, os.PathLike)) or isinstance(value, bytes) or value == "":
        refuse(name, value, "give a path, as a string or a Path")
    try:
        found = Path(value)
    except TypeError:
        refuse(name, value, "give a path, as a string or a Path")
    if "\0" in str(found):
        refuse(name, value, "give a path, without a null character")
    return found
