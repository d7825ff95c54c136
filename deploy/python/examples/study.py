#!/usr/bin/env python3
"""A study of the shipped hover formation: how much loss on the network does it bear, with and without its safety filter?

Needs the package skein-swarm. Run it in the folder that is to hold the results. If it was interrupted, run it again: it
resumes. `--seeds 6` is enough for a first look: a verdict needs six pairs of runs.
"""

import argparse
from pathlib import Path

import skein

NAME = "study"
LOSSES = [0, 0.1, 0.3]


def fly(folder, seeds, **keys):
    """The study in this folder: read if it is finished, else flown, with these keys of the scenario changed."""
    if (Path(folder) / "summary.json").is_file():
        return skein.load(folder)
    return skein.study("hover", seeds=seeds, sweep={"network.loss": LOSSES}, set=keys, out=folder, progress=True)


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--seeds", type=int, default=20, help="runs at each loss (default: 20)")
    seeds = arguments.parse_args().seeds

    filtered = fly(NAME, seeds)
    bare = fly(f"{NAME}-bare", seeds, **{"formation.safety_filter": "none"})

    # `runs` has one row a run, as a frame of pandas; skein.figures() explains the columns.
    for title, flown in [("with the safety filter", filtered), ("without", bare)]:
        print(f"\n{title}: medians at each loss")
        print(flown.runs.groupby("network.loss")[["even_10deg_s", "radial_rms_m", "min_separation_m"]].median().round(2))

    # Judged seed by seed: is the second study better, the same or worse?
    print("\nwithout the safety filter, compared with it:")
    print(skein.compare(filtered, bare, only=["min_separation_m", "even_10deg_s"])[["verdict", "a", "b", "difference"]])

    try:
        from skein import plot

        axes = plot.sweep(filtered, "network.loss", "even_10deg_s")
        axes.figure.savefig(f"{NAME}.png")
        print(f"\nthe picture is {NAME}.png")
    except ImportError:
        print("\nfor a picture: pip install matplotlib")


if __name__ == "__main__":
    main()
