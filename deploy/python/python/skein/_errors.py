"""The exceptions of the package."""

from __future__ import annotations

from typing import Optional


class SkeinError(Exception):
    """Skein cannot do what was asked. The text is the sentence that the command ``skein`` prints."""


class ScenarioError(SkeinError):
    """A scenario file or a set key is invalid.

    Attributes
    ----------
    file : str
        The file as it was given, or the option ``--set key=value``.
    line, column : int or None
        The place in the file, counted from 1; ``None`` for a set key.
    key : str or None
        The key that is invalid.
    message : str
        What is wrong.
    help : str or None
        How to correct it.
    """

    def __init__(
        self,
        text: str,
        *,
        file: str = "",
        line: Optional[int] = None,
        column: Optional[int] = None,
        key: Optional[str] = None,
        message: str = "",
        help: Optional[str] = None,
    ) -> None:
        super().__init__(text)
        self.file = file
        self.line = line
        self.column = column
        self.key = key
        self.message = message
        self.help = help


class ArgumentError(SkeinError, ValueError, TypeError):
    """An argument of a function is wrong. The text names the argument, its value, and what to write instead.

    It is a ``ValueError`` and a ``TypeError`` too, so that code that expects Python's own classes catches it.
    """


class NotFoundError(ArgumentError, KeyError, IndexError):
    """An argument names what does not exist: a key that is not swept, an unknown feature, a point beyond the last."""

    # A KeyError would show its text in quotes.
    __str__ = Exception.__str__
