"""Train the error model and the covariance calibration: scenes are tracked and compared with their truth.

    python scripts/train_error_model.py collect FOLDER --seeds 600:606                    track scenes, keep the results
    python scripts/train_error_model.py collect FOLDER --seeds 20:50 --evidence depth     the same before depth cameras
    python scripts/train_error_model.py fit FOLDER       fit, print how other seeds are judged, write both assets

Seeds below `error_scenes.JUDGES` are trained on, the others judge. FOLDER also serves the benchmark `error-model`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.multiview.error_fit import report_fit
from benchmarks.multiview.error_scenes import DEPTH, JUDGES, cases_of, collect, collect_depth, load_all
from benchmarks.multiview.spread_fit import judged_by_seed, write_spread


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("collect", "fit"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", default="600:606")
    parser.add_argument("--evidence", default="silhouettes,keypoints,both")
    parser.add_argument("--cases", default="", help="default: those that the seed shows")
    given = parser.parse_args()
    if given.what == "collect":
        first, stop = (int(x) for x in given.seeds.split(":"))
        for seed in range(first, stop):
            if given.evidence == "depth":
                for case in DEPTH:
                    collect_depth(given.folder, case, seed)
                continue
            for case in given.cases.split(",") if given.cases else cases_of(seed):
                collect(given.folder, case, seed, given.evidence.split(","))
        return
    clips = load_all(given.folder)
    report_fit(clips)
    write_spread([c for c in clips if c.seed < JUDGES])
    for evidence, by in judged_by_seed(clips).items():
        print(evidence, {g: (round(c, 3), round(e, 3)) for g, (c, e) in by.items()})


if __name__ == "__main__":
    main()
