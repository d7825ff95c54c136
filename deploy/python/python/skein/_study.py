"""Studies: many flights in virtual time."""

from __future__ import annotations

import importlib.util
import itertools
import json
import operator
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, Iterable, Mapping, Optional, Tuple, Type, Union

import pandas as pd

from . import _check, _skein
from ._errors import ArgumentError, NotFoundError, SkeinError
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
        self.folder = Path(_check.path("folder", folder))
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
            if _check.count("nth", nth, least=-(2**63)) not in range(1, points + 1):
                raise NotFoundError(f"point {nth}: the study has points 1 to {points}")
            each = len(runs) // points
            runs = runs.iloc[(nth - 1) * each : nth * each]
        for name, value in keys.items():
            key = name.replace("__", ".")
            if key not in self.swept:
                raise NotFoundError(f"{key} is not swept; swept: {', '.join(self.swept) or 'nothing'}")
            is_there = (runs[key] == value) if pd.api.types.is_scalar(value) else pd.Series(False, index=runs.index)
            if not is_there.any():
                flown = ", ".join(repr(one) for one in self.runs[key].drop_duplicates().tolist())
                raise NotFoundError(f"{name}={value!r}: no run has this value of {key}; the values are {flown}")
            runs = runs[is_there]
        return runs

    def _number_of_points(self) -> int:
        study = self.folder / "study.json"
        return int(json.loads(study.read_text("utf-8"))["points"]) if study.is_file() else 1

    def to_polars(self) -> "polars.DataFrame":
        """:attr:`runs` as a frame of polars, with ``null`` in place of ``NaN``."""
        try:
            import polars
        except ImportError:
            raise SkeinError("to_polars needs polars: pip install skein-swarm[polars]") from None
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
        path = self.folder / "runs.parquet" if path is None else Path(_check.path("path", path, "file"))
        try:
            self.runs.to_parquet(path, index=False)
        except ImportError:
            raise SkeinError(_NO_PARQUET) from None
        return path

    def save(self, folder: Union[str, "os.PathLike[str]"]) -> "Study":
        """Copies the whole folder to a new one, which ``skein compare`` and ``skein report`` read, and returns it."""
        folder = Path(_check.path("folder", folder))
        if folder.exists() and not folder.is_dir():
            raise SkeinError(f"{folder}: this is a file; choose a folder")
        if folder.exists() and any(folder.iterdir()):
            raise SkeinError(f"{folder}: the folder already contains files; choose another folder")
        shutil.copytree(self.folder, folder, dirs_exist_ok=True)
        return Study(folder)

    def recording(self, seed: Optional[int] = None, point: int = 1) -> Path:
        """The path of the recording of a run: that of this seed, or the only one."""
        if seed is not None:
            seed = _check.seed(seed)
        point = _check.count("point", point)
        found = sorted(self.folder.rglob("run.mcap"), key=_natural)
        if self.swept:
            found = [path for path in found if f"point-{point}" in path.parts]
        if seed is not None and len(self.runs) > 1:
            found = [path for path in found if path.parent.name == f"seed-{seed}"]
        if not found:
            raise SkeinError(f"{self.folder}: no recording of this run; see the key record.runs")
        return found[0]


def _natural(path: Path) -> Tuple[Any, ...]:
    return tuple(int(part) if part.isdigit() else part for part in re.split(r"(\d+)", str(path)))


#: More seeds than any study flies.
_MOST_SEEDS = 10_000_000


def _seed_range(seeds: Union[int, range, Iterable[int], None]) -> Optional[Tuple[int, int]]:
    """The first seed, and the one after the last."""
    wanted = "has to be a number of seeds, such as seeds=20, or a range of them without gaps, such as seeds=range(0, 20)"
    given = seeds
    if seeds is None:
        return None
    if isinstance(seeds, str):
        written = re.fullmatch(r"\s*(\d+)\.\.(\d+)\s*", seeds)
        _check.wrong("seeds", given, f"write seeds=range({written[1]}, {written[2]})" if written else wanted)
    if _check.is_whole(seeds):
        seeds = range(operator.index(seeds))  # type: ignore[arg-type]
    if not isinstance(seeds, range):
        try:
            listed = list(itertools.islice(seeds, _MOST_SEEDS + 1))  # type: ignore[arg-type]
        except TypeError:
            _check.wrong("seeds", given, wanted)
        if not listed or not all(_check.is_whole(seed) for seed in listed):
            _check.wrong("seeds", given, wanted)
        first = operator.index(listed[0])
        if [operator.index(seed) for seed in listed] != list(range(first, first + len(listed))):
            _check.wrong("seeds", given, wanted)
        seeds = range(first, first + len(listed))
    # A range of Python may be longer than its `len` can express.
    if seeds.start >= seeds.stop or seeds.step != 1 and seeds[:2] != seeds[:1]:
        _check.wrong("seeds", given, wanted)
    first, last = seeds[0], seeds[-1]
    if first < 0 or last > _check.MOST_SEED:
        _check.wrong("seeds", given, f"seeds are whole numbers from 0 to {_check.MOST_SEED}")
    if last - first >= _MOST_SEEDS:
        _check.wrong("seeds", given, f"{last - first + 1} runs are more than {_MOST_SEEDS}: fly fewer seeds")
    return first, last + 1


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
    threads: Optional[int] = None,
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
    threads : int, optional
        Threads that step each run; without it a fleet takes the cores that no other run uses. The results do not depend
        on it.
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
    wanted = {
        "scenario": scenario_path(scenario),
        "sets": law_sets(law, parameters) + sets(set),
        "seeds": _seed_range(seeds),
        "sweeps": sweeps(sweep),
        "points": None if points is None else _check.count("points", points, most=_MOST_SEEDS),
        "jobs": None if jobs is None else _check.count("jobs", jobs, most=_check.MOST_THREADS),
        "threads": None if threads is None else _check.count("threads", threads, most=_check.MOST_THREADS),
        "is_recorded": out is not None if record is None else _check.flag("record", record),
    }
    if _check.flag("parquet", parquet):
        _check_parquet()
    if not callable(progress):
        wanted_progress = "has to be True, False, or a function of the number of runs that are done and of all"
        if not isinstance(progress, bool):
            _check.wrong("progress", progress, wanted_progress)
    called = _to_stderr if progress is True else progress or None
    temporary = None
    if out is None:
        temporary = tempfile.TemporaryDirectory(prefix="skein-study-")
        out = temporary.name
    wanted["out"] = _check.path("out", out)
    _skein.fly_study(wanted, _skein.__file__, law, called)
    flown = Study(out, _temporary=temporary)
    if parquet:
        flown.to_parquet()
    return flown


_NO_PARQUET = "Parquet needs pyarrow: pip install pyarrow, or skein-swarm[parquet]"


def _check_parquet() -> None:
    """Refuses a study whose table could not be written after it has flown."""
    if not any(importlib.util.find_spec(name) for name in ("pyarrow", "fastparquet")):
        raise SkeinError(_NO_PARQUET)


def _to_stderr(done: int, runs: int) -> None:
    end = "\n" if done == runs else ""
    print(f"\r{done} of {runs} runs", end=end, file=sys.stderr, flush=True)


def load(folder: Union[str, "os.PathLike[str]"]) -> Study:
    """Reads what ``skein study``, ``skein fly`` or :func:`skein.study` wrote: one run, or a folder of many."""
    if isinstance(folder, Study):
        raise ArgumentError(f"folder={folder!r}: this is a study already; load takes the path of a folder")
    return Study(folder)


def _folder_of(name: str, side: Any) -> str:
    """The folder of a study, or this folder."""
    if isinstance(side, Study):
        return os.fspath(side.folder)
    if not isinstance(side, (str, os.PathLike)) or not os.fspath(side):
        _check.wrong(name, side, f"has to be a study of skein.study, or the path of a folder with runs, such as {name}='results'")
    return os.fspath(side)


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
        Compare only these figures; the keys are in :func:`skein.figures`.

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
    folders = [_folder_of(name, side) for name, side in (("a", a), ("b", b))]
    if isinstance(only, str):
        _check.wrong("only", only, f"has to be a list of figures: only=[{only!r}]")
    try:
        only = list(only)
    except TypeError:
        _check.wrong("only", only, 'has to be a list of figures, such as only=["collisions"]')
    for figure in only:
        if not isinstance(figure, str):
            _check.wrong("only", only, f'{figure!r} is not the key of a figure, such as "collisions"')
    is_judged, text = _skein.compare(folders[0], folders[1], only)
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
    if not rows:
        raise SkeinError(f"no pair of runs has a value of {', '.join(only) or 'any figure'}: choose other figures")
    frame = pd.DataFrame(rows)
    frame["worst_seed"] = frame["worst_seed"].astype("Int64")
    if len(compared["points"]) == 1 and not compared["points"][0]["set"]:
        return frame.drop(columns="point").set_index("figure")
    return frame.set_index(["point", "figure"])


def figures() -> pd.DataFrame:
    """The table of all figures, indexed by their key: ``unit``, ``worse`` (``more``, ``less`` or ``None``), ``meaning``."""
    return pd.DataFrame(_skein.figures(), columns=["figure", "unit", "worse", "meaning"]).set_index("figure")
