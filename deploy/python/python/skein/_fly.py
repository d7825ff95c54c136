"""Flights in real time, by the program ``skein``."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Mapping, Optional, Type, Union

from ._errors import SkeinError
from ._keys import Scenario, scenario_path, sets
from ._laws import Law, law_sets, law_spec
from ._study import Study

__all__ = ["fly", "program"]


def program() -> str:
    """The path of the program ``skein``: that of the variable ``SKEIN_PROGRAM``, beside this Python, or on the ``PATH``.

    Raises
    ------
    SkeinError
        If no such program is found.
    """
    beside = Path(sys.executable).parent
    found = os.environ.get("SKEIN_PROGRAM") or shutil.which("skein", path=str(beside)) or shutil.which("skein")
    if not found:
        raise SkeinError("the program skein is neither beside this Python nor on the PATH; SKEIN_PROGRAM names it")
    return found


def fly(
    scenario: Scenario = None,
    *,
    law: Optional[Type[Law]] = None,
    parameters: Optional[Mapping[str, Any]] = None,
    set: Optional[Mapping[str, Any]] = None,
    seed: Optional[int] = None,
    duration_s: Optional[float] = None,
    out: Union[str, "os.PathLike[str]", None] = None,
    quiet: bool = False,
) -> Study:
    """Flies a scenario in real time on this PC, as the command ``skein fly`` does, and waits for its end.

    Parameters
    ----------
    scenario, set, seed, parameters
        As for :func:`skein.study`.
    law : class, optional
        A subclass of :class:`skein.Law` in a file or a module. Each vehicle asks a Python process of its own.
    duration_s : float, optional
        How long to fly, s; without it in the scenario either, until Ctrl-C.
    out : path, optional
        Folder for the results, new or empty; without it a temporary one that goes with the returned object.
    quiet : bool
        Whether to show nothing of what the program writes.

    Returns
    -------
    Study
        The flight as a study of one run, with its figures and its recording.

    Raises
    ------
    SkeinError
        If the flight cannot begin, or failed.
    """
    if law is not None and law_spec(law).startswith("__main__:"):
        raise SkeinError(f"{law.__name__} was written in a notebook or at a prompt: put the class into a file of its own")
    temporary = None
    if out is None:
        temporary = tempfile.TemporaryDirectory(prefix="skein-flight-")
        out = temporary.name
    command = [program(), "fly"]
    path = scenario_path(scenario)
    command += [path] if path is not None else []
    for key in law_sets(law, parameters) + sets(set):
        command += ["--set", key]
    command += [] if seed is None else ["--seed", str(seed)]
    command += [] if duration_s is None else ["--duration", str(duration_s)]
    command += ["--out", os.fspath(out)]
    flown = subprocess.run(command, stdout=subprocess.DEVNULL if quiet else None, stderr=subprocess.PIPE if quiet else None)
    if flown.returncode != 0:
        lines = (flown.stderr or b"").decode("utf-8", "replace").strip().splitlines()
        raise SkeinError(lines[-1] if lines else f"skein fly ended with exit status {flown.returncode}")
    return Study(out, _temporary=temporary)
