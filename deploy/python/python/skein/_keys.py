"""Python values as values of scenario keys."""

from __future__ import annotations

import json
import os
import re
from typing import Any, Iterable, List, Mapping, Optional, Union

Scenario = Union[str, "os.PathLike[str]", None]

_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_\-]*")
_NOT_TEXT = {"true", "false", "inf", "nan"}


def toml_value(value: Any) -> str:
    """The value as TOML spells it."""
    if hasattr(value, "tolist"):  # an array or a number of numpy
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, os.PathLike):
        return json.dumps(os.fspath(value), ensure_ascii=False)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_table_key(key)} = {toml_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, Iterable):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    raise TypeError(f"a scenario key takes no {type(value).__name__}")


def _table_key(key: str) -> str:
    return key if _PLAIN.fullmatch(key) else json.dumps(key)


def set_value(value: Any) -> str:
    """The value as the option ``--set`` takes it: a plain text needs no quotes."""
    if isinstance(value, str) and _PLAIN.fullmatch(value) and value not in _NOT_TEXT:
        return value
    return toml_value(value)


def sets(keys: Optional[Mapping[str, Any]]) -> List[str]:
    """``{key: value}`` as the option ``--set`` takes them."""
    return [f"{key}={set_value(value)}" for key, value in (keys or {}).items()]


def sweeps(keys: Optional[Mapping[str, Any]]) -> List[str]:
    """``{key: values}`` as the option ``--sweep`` takes them; a text such as ``"0..0.5"`` is a range."""
    texts = []
    for key, values in (keys or {}).items():
        text = values if isinstance(values, str) else ",".join(set_value(value) for value in values)
        texts.append(f"{key}={text}")
    return texts


def scenario_path(scenario: Scenario) -> Optional[str]:
    """The scenario as the command takes it: a file, or the name of a shipped one."""
    return None if scenario is None else os.fspath(scenario)
