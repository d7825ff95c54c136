"""Serves a law as a program that follows the protocol of external laws: ``python -m skein._serve MODULE:CLASS``.

``MODULE`` is the name of a module or the path of a file.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import sys
from pathlib import Path
from typing import Dict, Type

from ._laws import Law, Observation, Setup, _Answer, _plain


def load_law(spec: str) -> Type[Law]:
    """The class that ``module:Class`` or ``file.py:Class`` names."""
    where, _, name = spec.rpartition(":")
    if where == "__main__":
        raise SystemExit(f"{name} was written in a notebook or at a prompt: put the class into a file of its own")
    if where.endswith(".py"):
        sys.path.insert(0, str(Path(where).parent))
        named = importlib.util.spec_from_file_location(Path(where).stem, where)
        if named is None or named.loader is None:
            raise SystemExit(f"{where}: not a Python file")
        module = importlib.util.module_from_spec(named)
        sys.modules[named.name] = module
        named.loader.exec_module(module)
    else:
        module = importlib.import_module(where)
    law = module
    for part in name.split("."):
        law = getattr(law, part)
    return law  # type: ignore[return-value]


def main() -> None:
    # The protocol has stdout; what a law prints goes to stderr.
    replies = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    law_class = load_law(sys.argv[1])
    laws: Dict[int, Law] = {}
    for line in sys.stdin:
        message = json.loads(line)
        if message["say"] == "hello":
            laws[message["vehicle"]] = law_class(Setup._of(message))
            reply = {"say": "ready", "protocol": 1}
        elif message["say"] == "ask":
            observation = Observation.from_json(message)
            answer = laws[observation.vehicle].answer(observation)
            if not isinstance(answer, _Answer):
                raise TypeError(f"answer gives a skein.Velocity or a skein.Field, not {answer!r}")
            numbers, heading, reached, log = _plain(answer)
            reply = {"say": "answer", "vehicle": observation.vehicle, "tick": observation.tick, answer._key: numbers}
            optional = {"heading_rad": heading, "reached": reached, "log": log}
            reply.update({key: value for key, value in optional.items() if value is not None})
        else:
            break
        replies.write(json.dumps(reply) + "\n")
        replies.flush()


if __name__ == "__main__":
    main()
