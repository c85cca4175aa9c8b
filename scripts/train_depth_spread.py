"""Fit the spread of depth and how likely joints are wrong: simulated recordings are tracked and compared with their
truth.

    python scripts/train_depth_spread.py FOLDER DATA --seeds 20:30    tracks, keeps what was found in FOLDER, fits,
                                                                      prints what regions hold of seeds left out

DATA holds the captured motion (mocap). With --write doubt, --write spread the assets are written.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.depth_sensors.depth_spread import (
    CASES,
    TRAINED,
    collect,
    fit_doubt,
    held_left_out,
    told_and_true,
    write_doubt,
    write_spread,
)


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("--seeds", default="20:30")
    parser.add_argument("--write", choices=("doubt", "spread"), action="append", default=[])
    given = parser.parse_args()
    first, stop = (int(x) for x in given.seeds.split(":"))
    if first not in TRAINED or stop > TRAINED.stop:
        parser.error(f"seeds of {TRAINED.start} to {TRAINED.stop - 1} are trained on; the others report")
    clips = []
    for seed in range(first, stop):
        for case in CASES:
            clips.append(collect(given.folder, case, seed, given.data))
            print(case, seed, flush=True)
    print({case: (round(j, 3), round(a, 3)) for case, (j, a) in held_left_out(clips).items()})
    half = sorted({c.seed for c in clips})[::2]
    fitted, rest = fit_doubt([c for c in clips if c.seed in half]), [c for c in clips if c.seed not in half]
    for what, said in told_and_true(rest, fitted).items():
        print(what, "wrong, told and error of the fit on other seeds, of silhouettes:", said)
    for what in given.write:
        {"doubt": write_doubt, "spread": write_spread}[what](clips)


if __name__ == "__main__":
    main()
