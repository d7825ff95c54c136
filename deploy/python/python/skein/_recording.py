"""Recordings as frames."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any, Dict, Union

import pandas as pd

from . import _check, _skein
from ._study import Study
from ._tables import read_csv

__all__ = ["Recording", "recording"]


class Recording:
    """A recorded flight. Times are in seconds from the start of the figures' window; earlier ones are negative.

    Attributes
    ----------
    steps : pandas.DataFrame
        Every step of every vehicle, ordered by time. Units end the names of columns; positions and velocities are north,
        east, down in the scenario's frame. ``north_m`` is the ground truth and ``estimate_north_m`` what the vehicle
        believed. Missing values are ``NaN``.
    events : pandas.DataFrame
        What vehicles reported of themselves: ``t_s``, ``vehicle``, ``text``.
    faults : pandas.DataFrame
        The faults that were injected: ``t_s``, ``vehicle`` (missing for a link), ``text``.
    peers : pandas.DataFrame
        The age of every peer's state at each step: ``t_s``, ``vehicle``, ``peer``, ``standing``, ``age_s``, ``delay_s``,
        ``delivered_age_s``.
    laws : pandas.DataFrame
        Numbers that external laws logged: ``t_s``, ``vehicle``, ``name``, ``value``.
    scenario : dict
        The complete scenario that flew.
    """

    def __init__(self, file: Union[str, "os.PathLike[str]"]) -> None:
        self.file = Path(_check.path("file", file, "recording"))
        with tempfile.TemporaryDirectory(prefix="skein-recording-") as folder:
            self.scenario: Dict[str, Any] = json.loads(_skein.recording_tables(os.fspath(file), folder))
            tables = {
                name: read_csv(Path(folder) / f"{name}.csv")
                for name in ("trace", "peers", "laws", "events")
            }
        self.steps, self.peers, self.laws = tables["trace"], tables["peers"], tables["laws"]
        noted = tables["events"]
        noted["vehicle"] = noted["vehicle"].astype("Int64")

        def of(kind: str) -> pd.DataFrame:
            return noted[noted["kind"] == kind].drop(columns="kind").reset_index(drop=True)

        self.events, self.faults = of("event"), of("fault")

    def __repr__(self) -> str:
        return f"<skein.Recording of {self.steps['vehicle'].nunique()} vehicles, {self.steps['t_s'].max():.1f} s: {self.file}>"


def recording(source: Union[Study, str, "os.PathLike[str]"]) -> Recording:
    """Reads a recording: an MCAP file, or the first one of a study or of a folder."""
    if not isinstance(source, (Study, str, os.PathLike)) or not isinstance(source, Study) and not os.fspath(source):
        _check.wrong("source", source, "has to be a study, or the path of a recording or of a folder with one")
    if not isinstance(source, Study) and Path(source).is_file():
        return Recording(source)
    return Recording((source if isinstance(source, Study) else Study(source)).recording())
