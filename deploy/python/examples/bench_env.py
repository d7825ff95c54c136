"""The speed of an environment against that of a study of the same runs, in this process and one thread each.

    python bench_env.py [--worlds 64] [--duration 100]
"""

import argparse
import time

import skein


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--worlds", type=int, default=64)
    options.add_argument("--duration", type=float, default=100.0)
    options.add_argument("--repeat", type=int, default=3)
    options = options.parse_args()
    vehicles, best = 0, {"study": float("inf"), "env": float("inf")}
    for _ in range(options.repeat):
        began = time.perf_counter()
        skein.study("hover", seeds=options.worlds, set={"duration_s": options.duration}, jobs=1)
        best["study"] = min(best["study"], time.perf_counter() - began)
        began = time.perf_counter()
        env = skein.Env("hover", worlds=options.worlds, action=None, duration_s=options.duration)
        env.reset(seed=0)
        while not (env.step()[3]).all():
            pass
        vehicles = env.vehicles
        env.figures()
        best["env"] = min(best["env"], time.perf_counter() - began)
    for name, seconds in best.items():
        speed = options.worlds * vehicles * options.duration / seconds
        print(f"{name}: {seconds:.2f} s, {speed:,.0f} vehicle seconds a second")
    print(f"env / study: {best['study'] / best['env']:.2f}")


if __name__ == "__main__":
    main()
