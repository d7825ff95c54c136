"""Checks of arguments: a wrong one is a sentence that names it, its value and the remedy."""

from __future__ import annotations

import difflib
import math
import operator
import os
import reprlib
from typing import Any, Iterable, Mapping, NoReturn, Optional

from ._errors import ArgumentError, NotFoundError

#: The largest seed: a scenario file, which is TOML, has integers of 64 bits with a sign.
MOST_SEED = 2**63 - 1
#: More threads or runs at once than any PC has cores: a slip of the pen, which would use up the memory.
MOST_THREADS = 1024


def wrong(name: str, value: Any, wanted: str) -> NoReturn:
    """Raises the error for this argument: what it has to be."""
    raise ArgumentError(f"{name}={reprlib.repr(value)}: {wanted}")


def meant(name: str, known: Iterable[str]) -> str:
    """Suggests the known name that is most similar, or lists all of them."""
    known = [str(one) for one in known]
    close = difflib.get_close_matches(str(name), known, n=1)
    return f"did you mean {close[0]}?" if close else f"there are: {', '.join(known) or 'none'}"


def unknown(name: str, what: str, known: Iterable[str]) -> NoReturn:
    """Raises the error for a name that does not exist."""
    raise NotFoundError(f"{name}: {what}; {meant(name, known)}")


def is_whole(value: Any) -> bool:
    """Whether the value is a whole number of Python or numpy, and not a truth value."""
    if isinstance(value, bool) or type(value).__name__ in ("bool_", "bool"):
        return False
    try:
        operator.index(value)
    except TypeError:
        return False
    return True


def count(name: str, value: Any, least: int = 1, most: Optional[int] = None) -> int:
    """A whole number within these bounds."""
    if not is_whole(value) or operator.index(value) < least or most is not None and operator.index(value) > most:
        to = "" if most is None else f" and of {most} at most"
        wrong(name, value, f"has to be a whole number of {least} at least{to}, such as {name}={max(least, 1)}")
    return operator.index(value)


def seed(value: Any, name: str = "seed") -> int:
    """The number of a world."""
    if not is_whole(value) or not 0 <= operator.index(value) <= MOST_SEED:
        wrong(name, value, f"a seed has to be a whole number from 0 to {MOST_SEED}, such as {name}=7")
    return operator.index(value)


def number(name: str, value: Any, above: Optional[float] = None) -> float:
    """A finite number: above this bound, or without one of 0 at least."""
    is_number = not isinstance(value, (bool, str, bytes)) and type(value).__name__ not in ("bool_", "bool")
    try:
        number = float(value) if is_number else math.nan
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number) or number < 0 or above is not None and number <= above:
        bound = "of 0 at least" if above is None else f"above {above:g}"
        wrong(name, value, f"has to be a number {bound}, such as {name}=20")
    return number


def flag(name: str, value: Any) -> bool:
    """True or false."""
    if value is not True and value is not False and type(value).__name__ not in ("bool_", "bool"):
        wrong(name, value, f"has to be {name}=True or {name}=False")
    return bool(value)


def function(name: str, value: Any, wanted: str) -> Any:
    """Something that can be called."""
    if not callable(value):
        wrong(name, value, wanted)
    return value


def path(name: str, value: Any, what: str = "folder") -> str:
    """The path of a file or folder."""
    if not isinstance(value, (str, os.PathLike)) or not os.fspath(value):
        wrong(name, value, f'has to be the path of a {what}, such as {name}="results"')
    return os.fsdecode(os.fspath(value))


def mapping(name: str, value: Any, example: str) -> Mapping[str, Any]:
    """A mapping of texts to values; ``None`` is an empty one."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        wrong(name, value, f"has to be a mapping, such as {name}={example}")
    for key in value:
        if not isinstance(key, str) or not key.strip():
            wrong(name, value, f"the key {key!r} is not a text: write {name}={example}")
    return value


def choice(name: str, value: Any, known: Iterable[Any]) -> Any:
    """One of these values."""
    known = list(known)
    if not any(value is one or isinstance(value, str) and value == one for one in known):
        shown = " or ".join(", ".join(repr(one) for one in part) for part in (known[:-1], known[-1:]) if part)
        close = difflib.get_close_matches(value, [one for one in known if isinstance(one, str)], n=1) if isinstance(value, str) else []
        wrong(name, value, f"{_a(name)} has to be {shown}" + (f"; did you mean {close[0]!r}?" if close else ""))
    return value


def _a(name: str) -> str:
    return ("an " if name[0] in "aeiou" else "a ") + name
