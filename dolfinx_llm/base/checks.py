"""Checks of arguments: what was given, and what is accepted, in one sentence.

Each returns the argument in the one type that is used from then on. Numbers of NumPy and arrays
without dimension are numbers; a bool is none. Texts are the same on every rank.
"""

from __future__ import annotations

import numbers
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np

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


def refuse(name: str, value: Any, accepted: str) -> NoReturn:
    """Raise for an argument.

    Args:
        name: of the argument.
        value: what was given.
        accepted: goes on after "name=value: ", e.g. "give a positive number".

    Raises:
        ContactInputError: always.
    """
    raise ContactInputError(f"{name}={shown(value)}: {accepted}")


def _plain(value: Any) -> Any:
    """An array without dimension as its entry."""
    return value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value


def integer(
    name: str, value: Any, accepted: str = "give an integer", low: int | None = None
) -> int:
    """An integer, of Python or NumPy.

    Args:
        name: of the argument.
        value: what was given.
        accepted: for the message.
        low: smallest that is accepted.

    Raises:
        ContactInputError: another type (bool too), or a value below ``low``.

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
    """A finite real number.

    Args:
        name: of the argument.
        value: what was given.
        accepted: for the message.
        low: smallest that is accepted.
        above: what it must exceed.

    Raises:
        ContactInputError: another type (bool too), NaN, infinite, or outside the bounds.

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
    """True or False.

    Raises:
        ContactInputError: anything else, also 0, 1 and strings.
    """
    plain = _plain(value)
    if not isinstance(plain, (bool, np.bool_)):
        refuse(name, value, "give True or False")
    return bool(plain)


def one_of(name: str, value: T, choices: Sequence[T]) -> T:
    """One of several strings, or None.

    Raises:
        ContactInputError: it is none of the choices.
    """
    if not ((value is None or isinstance(value, str)) and value in choices):
        refuse(name, value, f"choose one of {tuple(choices)}")
    return value


def instance(name: str, value: Any, kind: type[T] | tuple[type[T], ...], accepted: str) -> T:
    """An object of a class.

    Raises:
        ContactInputError: of another.
    """
    if not isinstance(value, kind):
        refuse(name, value, accepted)
    return value


def items(name: str, value: Any, accepted: str) -> list[Any]:
    """The items of a list, a tuple or the like.

    Raises:
        ContactInputError: it is a string, a dict, or has no items.
    """
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
) -> np.ndarray:
    """A finite array of a shape.

    Args:
        name: of the argument.
        value: an array, or what makes one.
        shape: its sizes; None: any.
        accepted: for the message.
        integers: node numbers and the like, otherwise real numbers.

    Raises:
        ContactInputError: another shape or type (bool, complex, ragged), or values that are not
            finite.

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
    """A path, of a string or a ``Path``.

    Raises:
        ContactInputError: it is something else, or empty.
    """
    if not isinstance(value, (str, os.PathLike)) or isinstance(value, bytes) or value == "":
        refuse(name, value, "give a path, as a string or a Path")
    try:
        found = Path(value)
    except TypeError:
        refuse(name, value, "give a path, as a string or a Path")
    if "\0" in str(found):
        refuse(name, value, "give a path, without a null character")
    return found
