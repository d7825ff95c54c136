"""Studies: many flights in virtual time."""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, Iterable, Mapping, Optional, Tuple, Type, Union

import pandas as pd

from . import _skein
from ._errors import SkeinError
from ._keys import Scenario, scenario_path, sets, sweeps
from ._laws import Law, law_sets
from ._tables import read_csv, row_of_run

if TYPE_CHECKING:
    import polars

__all__ = ["Study", "study", "load", "compare", "figures"]


class Study:
    """The results of a study, of a flight, or of any folder of them.

    Attributes
    ----------
    folder : pathlib.Path
        The folder with the files of all runs.
    runs : pandas.DataFrame
        One row a run, with the columns of ``runs.csv``: the seed, the swept keys, and every figure. A figure without a
        value is ``NaN``. :func:`skein.figures` explains the figures and their units.
    summary : pandas.DataFrame
        One row a figure, indexed by it; of a sweep one row a point and figure. Columns: ``n`` (runs in which the figure
        applies), ``never`` (runs in which its event did not happen; they rank worst), ``q1``, ``median``, ``q3``,
        ``min``, ``max``, ``worst`` and ``worst_seed``.
    swept : list of str
        The swept keys.
    """

    def __init__(self, folder: Union[str, "os.PathLike[str]"], *, _temporary: Any = None) -> None:
        self.folder = Path(folder)
        self._temporary = _temporary  # deletes the folder with this object
        if not self.folder.is_dir():
            raise SkeinError(f"{self.folder}: no such folder")
        self.swept = self._read_swept()
        self.runs = self._read_runs()
        self._summary: Optional[pd.DataFrame] = None

    def __repr__(self) -> str:
        swept = f", swept: {', '.join(self.swept)}" if self.swept else ""
        return f"<skein.Study of {len(self.runs)} runs in {self.folder}{swept}>"

    def __len__(self) -> int:
        return len(self.runs)

    def _read_swept(self) -> list:
        study = self.folder / "study.json"
        if not study.is_file():
            return []
        return [sweep.split("=", 1)[0].strip() for sweep in json.loads(study.read_text("utf-8"))["sweep"]]

    def _read_runs(self) -> pd.DataFrame:
        table = self.folder / "runs.csv"
        if table.is_file():
            return read_csv(table)
        found = sorted(self.folder.rglob("metrics.json"), key=_natural)
        if not found:
            raise SkeinError(f"{self.folder}: no runs in it: a run is a folder with metrics.json and scenario.toml")
        return pd.DataFrame([row_of_run(json.loads(path.read_text("utf-8"))) for path in found])

    @property
    def summary(self) -> pd.DataFrame:
        if self._summary is None:
            self._summary = self._read_summary()
        return self._summary

    def _read_summary(self) -> pd.DataFrame:
        path = self.folder / "summary.json"
        if not path.is_file():
            raise SkeinError(f"{path}: only a finished study has a summary")
        summary = json.loads(path.read_text("utf-8"))
        if isinstance(summary, dict):
            frame = pd.DataFrame.from_dict(summary, orient="index")
            frame.index.name = "figure"
            return frame
        rows = [
            {"point": point["point"], **point["set"], "figure": figure, **values}
            for point in summary
            for figure, values in point["figures"].items()
        ]
        return pd.DataFrame(rows).set_index(["point", "figure"])

    def point(self, nth: Optional[int] = None, **keys: Any) -> pd.DataFrame:
        """The runs of one point of a sweep.

        Parameters
        ----------
        nth : int, optional
            The number of the point, counted from 1 as the folders ``point-1`` and so on are.
        **keys
            Or values of swept keys; with the dots of a key replaced by two underscores: ``network__loss=0.1``.

        Examples
        --------
        >>> import skein
        >>> flown = skein.study("hover", seeds=2, sweep={"network.loss": [0, 0.2]}, set={"duration_s": 5})
        >>> len(flown.point(2)), len(flown.point(network__loss=0.2))
        (2, 2)
        """
        runs = self.runs
        if nth is not None:
            points = self._number_of_points()
            if not 1 <= nth <= points:
                raise IndexError(f"point {nth}: the study has points 1 to {points}")
            each = len(runs) // points
            runs = runs.iloc[(nth - 1) * each : nth * each]
        for name, value in keys.items():
            key = name.replace("__", ".")
            if key not in self.swept:
                raise KeyError(f"{key} is not swept; swept: {', '.join(self.swept) or 'nothing'}")
            runs = runs[runs[key] == value]
        return runs

    def _number_of_points(self) -> int:
        study = self.folder / "study.json"
        return int(json.loads(study.read_text("utf-8"))["points"]) if study.is_file() else 1

    def to_polars(self) -> "polars.DataFrame":
        """:attr:`runs` as a frame of polars, with ``null`` in place of ``NaN``."""
        import polars

        return polars.from_pandas(self.runs, nan_to_null=True)

    def to_parquet(self, path: Union[str, "os.PathLike[str]", None] = None) -> Path:
        """Writes :attr:`runs` as a Parquet file, which other tools read without parsing text, and returns its path.

        Parameters
        ----------
        path : path, optional
            The file; an existing one is replaced. Without it ``runs.parquet`` in the folder of the study.

        Raises
        ------
        SkeinError
            If no package that writes Parquet is installed.
        """
        path = self.folder / "runs.parquet" if path is None else Path(path)
        try:
            self.runs.to_parquet(path, index=False)
        except ImportError:
            raise SkeinError("Parquet needs pyarrow: pip install pyarrow, or skein-swarm[parquet]") from None
        return path

    def save(self, folder: Union[str, "os.PathLike[str]"]) -> "Study":
        """Copies the whole folder to a new one, which ``skein compare`` and ``skein report`` read, and returns it."""
        folder = Path(folder)
        if folder.exists() and any(folder.iterdir()):
            raise SkeinError(f"{folder}: the folder already contains files; choose another folder")
        shutil.copytree(self.folder, folder, dirs_exist_ok=True)
        return Study(folder)

    def recording(self, seed: Optional[int] = None, point: int = 1) -> Path:
        """The path of the recording of a run: that of this seed, or the only one."""
        found = sorted(self.folder.rglob("run.mcap"), key=_natural)
        if self.swept:
            found = [path for path in found if f"point-{point}" in path.parts]
        if seed is not None and len(self.runs) > 1:
            found = [path for path in found if path.parent.name == f"seed-{seed}"]
        if not found:
            raise SkeinError(f"{self.folder}: no recording of this run; see the key record.runs")
        return found[0]


def _natural(path: Path) -> Tuple[Any, ...]:
    import re

    return tuple(int(part) if part.isdigit() else part for part in re.split(r"(\d+)", str(path)))


def _seed_range(seeds: Union[int, range, Iterable[int], None]) -> Optional[Tuple[int, int]]:
    if seeds is None:
        return None
    if isinstance(seeds, int):
        seeds = range(seeds)
    seeds = list(seeds)
    if not seeds or seeds != list(range(seeds[0], seeds[0] + len(seeds))) or seeds[0] < 0:
        raise ValueError("seeds are a number of them or a range without gaps, such as range(100)")
    return seeds[0], seeds[-1] + 1


def study(
    scenario: Scenario = None,
    *,
    seeds: Union[int, range, Iterable[int], None] = None,
    set: Optional[Mapping[str, Any]] = None,
    sweep: Optional[Mapping[str, Any]] = None,
    points: Optional[int] = None,
    law: Optional[Type[Law]] = None,
    parameters: Optional[Mapping[str, Any]] = None,
    jobs: Optional[int] = None,
    threads: int = 1,
    out: Union[str, "os.PathLike[str]", None] = None,
    record: Optional[bool] = None,
    parquet: bool = False,
    progress: Union[bool, Callable[[int, int], Any]] = False,
) -> Study:
    """Flies a scenario in virtual time, once for each seed, as the command ``skein study`` does, with the same bits.

    Ctrl-C stops it. The interpreter's lock is released while the swarms fly.

    Parameters
    ----------
    scenario : str or path, optional
        A scenario file, or the name of a shipped scenario such as ``"hover"``, ``"flock"`` or ``"tour"``.
    seeds : int or range, optional
        The seeds: ``100`` is ``range(100)``. Without it the scenario's own seed flies.
    set : mapping, optional
        Keys of the scenario and their values, such as ``{"formation.radius_m": 50}``.
    sweep : mapping, optional
        Keys and their values, such as ``{"network.loss": [0, 0.1]}``; several keys span a grid. A text such as
        ``"0..0.5"`` or ``"1..100:log"`` is a range, which is sampled at ``points`` points of a Latin hypercube.
    law : class, optional
        A subclass of :class:`skein.Law`, which flies in this process. The scenario's law becomes ``external``.
    parameters : mapping, optional
        The parameters of that law, ``formation.external.parameters``.
    jobs : int, optional
        Runs at once; without it one for each core. The results do not depend on it.
    threads : int
        Threads that step each run, for one run of many vehicles. The results do not depend on it.
    out : path, optional
        Folder for the results, new or empty, or that of the same study, interrupted: it resumes there. Without it the
        files lie in a temporary folder that goes with the returned object; :meth:`Study.save` keeps them.
    record : bool, optional
        Whether to record what ``record.runs`` asks for; without it only if ``out`` is given.
    parquet : bool
        Whether to write ``runs.parquet`` beside ``runs.csv`` too, as :meth:`Study.to_parquet` does.
    progress : bool or callable
        ``True`` writes a line to stderr; a callable is called with the number of runs that are done and of all.

    Returns
    -------
    Study

    Raises
    ------
    ScenarioError
        If the scenario or a set key is invalid.
    SkeinError
        If the study cannot be flown.

    Examples
    --------
    >>> import skein
    >>> flown = skein.study("hover", seeds=range(4), set={"duration_s": 20})
    >>> flown.runs[["seed", "collisions"]].sum().astype(int).to_dict()
    {'seed': 6, 'collisions': 0}
    """
    temporary = None
    if out is None:
        temporary = tempfile.TemporaryDirectory(prefix="skein-study-")
        out = temporary.name
    wanted = {
        "scenario": scenario_path(scenario),
        "sets": law_sets(law, parameters) + sets(set),
        "seeds": _seed_range(seeds),
        "sweeps": sweeps(sweep),
        "points": points,
        "jobs": jobs,
        "threads": threads,
        "out": os.fspath(out),
        "is_recorded": temporary is None if record is None else record,
    }
    called = _to_stderr if progress is True else progress or None
    _skein.fly_study(wanted, _skein.__file__, law, called)
    flown = Study(out, _temporary=temporary)
    if parquet:
        flown.to_parquet()
    return flown


def _to_stderr(done: int, runs: int) -> None:
    end = "\n" if done == runs else ""
    print(f"\r{done} of {runs} runs", end=end, file=sys.stderr, flush=True)


def load(folder: Union[str, "os.PathLike[str]"]) -> Study:
    """Reads what ``skein study``, ``skein fly`` or :func:`skein.study` wrote: one run, or a folder of many."""
    return Study(folder)


def compare(
    a: Union[Study, str, "os.PathLike[str]"],
    b: Union[Study, str, "os.PathLike[str]"],
    only: Iterable[str] = (),
) -> pd.DataFrame:
    """Compares two studies seed by seed, with the verdict of ``skein compare``.

    Parameters
    ----------
    a, b : Study or path
        What is compared with, and what is judged.
    only : iterable of str
        Compare only these figures.

    Returns
    -------
    pandas.DataFrame
        One row a figure, indexed by it; of a sweep indexed by the point, too. Columns: ``verdict`` (``better``, ``same``,
        ``worse``, ``unclear``: of ``b``), ``a``, ``b`` and ``difference`` (medians, with ``_low`` and ``_high``, the ends of
        their 95 % intervals), ``effect`` (share of pairs in which ``b`` is notably better, less the share in which it is
        worse), ``pairs``, ``better``, ``worse`` (numbers of pairs), ``never_a``, ``never_b``, ``worst_seed``, and ``replay``,
        the command that flies ``b``'s worst run again. Of flights in virtual time against flights in real time:
        ``a``, ``b``, ``difference`` and ``relative``, without a verdict.
    """
    folders = [os.fspath(side.folder) if isinstance(side, Study) else os.fspath(side) for side in (a, b)]
    is_judged, text = _skein.compare(folders[0], folders[1], list(only))
    compared = json.loads(text)
    if not is_judged:
        rows = [
            {"figure": row["key"], **{key: row[key] for key in ("a", "b", "difference", "relative")}}
            for row in compared["figures"]
        ]
        return pd.DataFrame(rows, columns=["figure", "a", "b", "difference", "relative"]).set_index("figure")
    rows = []
    for point in compared["points"]:
        for figure in point["figures"]:
            row = {"point": ", ".join(point["set"]), "figure": figure["key"], "verdict": figure["verdict"]}
            for side in ("a", "b", "difference", "effect"):
                row[side] = figure[side]["median"]
                row[f"{side}_low"], row[f"{side}_high"] = figure[side]["low"], figure[side]["high"]
            for key in ("pairs", "better", "worse"):
                row[key] = figure[key]
            row["never_a"], row["never_b"] = figure["never"]
            row["worst_seed"], row["replay"] = figure["worst_seed"], figure["replay"]
            rows.append(row)
    frame = pd.DataFrame(rows)
    frame["worst_seed"] = frame["worst_seed"].astype("Int64")
    if len(compared["points"]) == 1 and not compared["points"][0]["set"]:
        return frame.drop(columns="point").set_index("figure")
    return frame.set_index(["point", "figure"])


def figures() -> pd.DataFrame:
    """The table of all figures, indexed by their key: ``unit``, ``worse`` (``more``, ``less`` or ``None``), ``meaning``."""
    return pd.DataFrame(_skein.figures(), columns=["figure", "unit", "worse", "meaning"]).set_index("figure")
