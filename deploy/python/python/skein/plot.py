"""Figures by matplotlib. Every function draws into ``ax``, or into a new figure, and returns the axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Optional

import numpy as np
import pandas as pd

from . import _check
from ._errors import ArgumentError, NotFoundError, SkeinError
from ._recording import Recording
from ._study import Study, figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["tracks", "distances", "sweep"]


def _axes(ax: Optional["Axes"]) -> "Axes":
    try:
        import matplotlib.pyplot as plt
        from matplotlib.axes import Axes
    except ImportError:
        raise SkeinError("skein.plot needs matplotlib: pip install skein-swarm[plot]") from None
    if ax is not None:
        if not isinstance(ax, Axes):
            _check.wrong("ax", ax, "one axes of matplotlib is wanted; of several panels choose one, such as axes[0]")
        return ax
    return plt.subplots(layout="constrained")[1]


def _check_recording(recording: Any) -> None:
    if not isinstance(recording, Recording):
        _check.wrong("recording", recording, "a recording is wanted: skein.recording(...) reads one")


def tracks(recording: Recording, ax: Optional["Axes"] = None) -> "Axes":
    """The true paths of all vehicles seen from above, in m: a circle and the vehicle's id where each ends, and the
    formation's last centre."""
    _check_recording(recording)
    ax = _axes(ax)
    for vehicle, steps in recording.steps.groupby("vehicle"):
        (line,) = ax.plot(steps["east_m"], steps["north_m"], linewidth=0.9, label=f"vehicle {vehicle}")
        end = (steps["east_m"].iloc[-1], steps["north_m"].iloc[-1])
        ax.plot(*end, "o", color=line.get_color(), markersize=5)
        # Its id at its end: a legend of all vehicles would cover a small panel, or lie on the neighbouring one.
        ax.annotate(
            str(vehicle),
            end,
            xytext=(4, 4),
            textcoords="offset points",
            color=line.get_color(),
            fontsize="small",
            clip_on=True,
        )
    last = recording.steps.iloc[-1]
    centre = ax.plot(last["centre_east_m"], last["centre_north_m"], "+", color="0.3", markersize=9, label="centre")
    ax.margins(0.08)
    ax.set(xlabel="east, m", ylabel="north, m", aspect="equal")
    ax.legend(handles=centre, fontsize="small", loc="lower left", frameon=False, handletextpad=0.2, borderpad=0.2)
    return ax


def distances(recording: Recording, ax: Optional["Axes"] = None) -> "Axes":
    """The least distance of any pair of vehicles, and the distances of all from the centre, in m over time."""
    _check_recording(recording)
    ax = _axes(ax)
    steps = recording.steps
    wide = {name: steps.pivot_table(index="t_s", columns="vehicle", values=name) for name in ("north_m", "east_m", "down_m")}
    for nth, vehicle in enumerate(wide["north_m"]):
        its = steps[steps["vehicle"] == vehicle]
        from_centre = np.hypot(its["north_m"] - its["centre_north_m"], its["east_m"] - its["centre_east_m"])
        ax.plot(its["t_s"], from_centre, color="0.7", linewidth=0.8, label="from the centre" if nth == 0 else None)
    if wide["north_m"].shape[1] > 1:
        points = np.stack([wide[name].to_numpy() for name in ("north_m", "east_m", "down_m")], axis=-1)
        first, other = np.triu_indices(points.shape[1], k=1)
        apart = np.linalg.norm(points[:, first] - points[:, other], axis=-1)
        nearest = np.fmin.reduce(apart, axis=1)
        ax.plot(wide["north_m"].index, nearest, color="C3", linewidth=1.2, label="nearest pair")
    ax.set(xlabel="time, s", ylabel="distance, m")
    ax.set_ylim(bottom=0)
    ax.legend(fontsize="small", frameon=False)
    return ax


def sweep(study: Study, x: str, y: str, ax: Optional["Axes"] = None, **keys: Any) -> "Axes":
    """A figure against a swept key: a point for each run, the median as a line, and the quartiles as a band.

    Runs in which the figure has no value are left out; their share is written at the upper edge.

    Parameters
    ----------
    study : Study
        A study with a sweep.
    x, y : str
        The swept key and the figure.
    **keys
        Values of other swept keys, as :meth:`Study.point` takes them, to draw one cut of a grid.
    """
    if not isinstance(study, Study):
        _check.wrong("study", study, "a study is wanted: skein.study(...) flies one, skein.load(...) reads one")
    if not isinstance(x, str) or x not in study.swept:
        raise NotFoundError(f"{x} is not swept; swept: {', '.join(study.swept) or 'nothing'}")
    if not isinstance(y, str) or y not in study.runs:
        _check.unknown(str(y), "no figure of this study", study.runs.columns)
    if not pd.api.types.is_numeric_dtype(study.runs[y]):
        raise ArgumentError(f"y={y!r}: this column has texts; choose a figure with numbers")
    runs = study.point(**keys)
    ax = _axes(ax)
    is_number = pd.api.types.is_numeric_dtype(runs[x])
    places = runs[x] if is_number else runs[x].astype("category").cat.codes
    by = runs[y].groupby(places)
    low, middle, high = (by.quantile(share) for share in (0.25, 0.5, 0.75))
    ax.fill_between(middle.index, low, high, alpha=0.2, linewidth=0, label="quartiles")
    ax.plot(places, runs[y], "o", color="0.45", markersize=2.5, alpha=0.6)
    ax.plot(middle.index, middle, "o-", color="C0", label="median")
    for place, share in runs[y].isna().groupby(places).mean().items():
        if share > 0:
            ax.annotate(f"{share:.0%} none", (place, 1.0), xycoords=("data", "axes fraction"), ha="center", va="top", fontsize="small")
    if not is_number:
        ax.set_xticks(range(runs[x].nunique()), sorted(runs[x].unique()))
    table = figures()
    unit = table["unit"].get(y)
    ax.set(xlabel=x, ylabel=f"{y}, {unit}" if unit else y)
    ax.legend(fontsize="small", frameon=False)
    return ax
