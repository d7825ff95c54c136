"""Flights in real time, by the program ``skein``."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import IO, Any, List, Mapping, Optional, Type, Union

from . import _check
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

    Ctrl-C lands the swarm and returns the flight; the program ends in a moment if it is pressed again. A third one kills it.

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
        If the flight cannot begin, or failed: with the sentence that the command writes to stderr.
    """
    keys = law_sets(law, parameters) + sets(set)
    quiet = _check.flag("quiet", quiet)
    path = scenario_path(scenario)
    if law is not None and law_spec(law).startswith("__main__:"):
        raise SkeinError(f"{law.__name__} was written in a notebook or at a prompt: put the class into a file of its own")
    temporary = None
    if out is None:
        temporary = tempfile.TemporaryDirectory(prefix="skein-flight-")
        out = temporary.name
    command = [program(), "fly"]
    command += [path] if path is not None else []
    for key in keys:
        command += ["--set", key]
    command += [] if seed is None else ["--seed", str(_check.seed(seed))]
    command += [] if duration_s is None else ["--duration", repr(_check.number("duration_s", duration_s, above=0))]
    command += ["--out", _check.path("out", out)]
    status, written = _run(command, quiet)
    if status != 0:
        raise SkeinError(_sentence(written) or f"skein fly ended with exit status {status}")
    return Study(out, _temporary=temporary)


def _run(command: List[str], quiet: bool) -> Any:
    """Runs the program, shows what it writes unless it is to be quiet, and gives its exit status and what it wrote to stderr."""
    written: List[str] = []

    def read(stderr: IO[str]) -> None:
        for line in stderr:
            written.append(line.rstrip("\n"))
            if not quiet:
                # The stderr of Python: a notebook shows it, unlike that of the process.
                print(line, end="", file=sys.stderr, flush=True)

    try:
        process = subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL if quiet else None,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            errors="replace",
        )
    except OSError as error:
        raise SkeinError(f"{command[0]}: {error.strerror}; SKEIN_PROGRAM names the program skein") from None
    with process:
        reader = threading.Thread(target=read, args=(process.stderr,), daemon=True)
        reader.start()
        try:
            status = _wait(process)
        except BaseException:
            process.kill()
            raise
        reader.join()
    return status, written


def _wait(process: "subprocess.Popen[str]") -> int:
    """Waits for the end of the program. Ctrl-C is no reason to leave it: it lands the swarm and writes its results."""
    try:
        return process.wait()
    except KeyboardInterrupt:
        pass  # A terminal sends Ctrl-C to the program too.
    try:
        return process.wait()
    except KeyboardInterrupt:
        process.send_signal(signal.SIGINT if os.name == "posix" else signal.SIGTERM)
    return process.wait()


def _sentence(written: List[str]) -> str:
    """The error at the end of what the command wrote: its last line, or from the line on with which an error of an option begins."""
    lines = [line.strip() for line in written if line.strip() and not line.startswith("For more information")]
    begins = [nth for nth, line in enumerate(lines) if line.startswith("error: ")]
    return "\n".join(lines[begins[-1] :]) if begins else "".join(lines[-1:])
