"""Tables in files, read without the loss of a bit."""

from __future__ import annotations

import os
import warnings
from typing import Any, Dict, Mapping, Union

import pandas as pd

from . import _skein


def read_csv(path: Union[str, "os.PathLike[str]"]) -> pd.DataFrame:
    """A table of Skein, every number the very one that was written."""
    with warnings.catch_warnings():
        # Newer releases of pandas read exactly without being asked.
        warnings.simplefilter("ignore")
        try:
            return pd.read_csv(path, float_precision="round_trip")
        except TypeError:
            return pd.read_csv(path)


def row_of_run(run: Mapping[str, Any]) -> Dict[str, Any]:
    """A run's figures from its ``metrics.json``, in the order of ``runs.csv``."""
    figures = sorted(key for key, _, _, _ in _skein.figures() if key in run and key != "never")
    return {"seed": run["seed"], **{key: float("nan") if run[key] is None else run[key] for key in figures}}
