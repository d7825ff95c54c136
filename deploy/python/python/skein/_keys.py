"""Python values as values of scenario keys."""

from __future__ import annotations

import json
import os
import re
from typing import Any, Iterable, List, Mapping, Optional, Union

from . import _check
from ._errors import ArgumentError

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
    if isinstance(value, Iterable) and not isinstance(value, (bytes, bytearray)):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    raise ArgumentError(
        f"a scenario key takes no {type(value).__name__}: give a number, a text, True or False, a list or a mapping"
    )


def _table_key(key: Any) -> str:
    if not isinstance(key, str):
        raise ArgumentError(f"the key {key!r} of a table is not a text: write it in quotes")
    return key if _PLAIN.fullmatch(key) else json.dumps(key)


def set_value(value: Any) -> str:
    """The value as the option ``--set`` takes it: a plain text needs no quotes."""
    if isinstance(value, str) and _PLAIN.fullmatch(value) and value not in _NOT_TEXT:
        return value
    return toml_value(value)


def _of_key(argument: str, key: str, value: Any) -> str:
    try:
        return set_value(value)
    except ArgumentError as error:
        raise ArgumentError(f"{argument}: {key}: {error}") from None


def sets(keys: Optional[Mapping[str, Any]], argument: str = "set") -> List[str]:
    """``{key: value}`` as the option ``--set`` takes them."""
    keys = _check.mapping(argument, keys, '{"formation.radius_m": 50}')
    return [f"{key}={_of_key(argument, key, value)}" for key, value in keys.items()]


def sweeps(keys: Optional[Mapping[str, Any]]) -> List[str]:
    """``{key: values}`` as the option ``--sweep`` takes them; a text such as ``"0..0.5"`` is a range."""
    texts = []
    for key, values in _check.mapping("sweep", keys, '{"network.loss": [0, 0.1]}').items():
        if isinstance(values, str):
            text = values
        else:
            if isinstance(values, (bytes, Mapping)) or not isinstance(values, Iterable) or getattr(values, "shape", 1) == ():
                values_of = f'several values, such as [{_example(values)}], or a range as a text, such as "0..0.5"'
                _check.wrong(f"sweep: {key}", values, f"a swept key takes {values_of}; one value belongs to set")
            text = ",".join(_of_key("sweep", key, value) for value in values)
        if not text:
            _check.wrong(f"sweep: {key}", values, "there is no value to fly; give several, such as [0, 0.1]")
        texts.append(f"{key}={text}")
    return texts


def _example(value: Any) -> str:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return f"0, {value!r}" if is_number and value else "0, 0.1"


def scenario_path(scenario: Scenario) -> Optional[str]:
    """The scenario as the command takes it: a file, or the name of a shipped one."""
    if scenario is None:
        return None
    if not isinstance(scenario, (str, os.PathLike)) or not os.fspath(scenario):
        _check.wrong("scenario", scenario, 'has to be the path of a scenario file or the name of a shipped one, such as "hover"')
    return os.fspath(scenario)
