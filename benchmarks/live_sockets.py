"""Latency of `hypose fuse --live` through real sockets: python -m benchmarks.live_sockets [--seconds 20] [--repeat 3].

Prints, for one and for six persons seen by three sensors of which one is dead for two seconds, the latency, the frames
that did not come, and by how much this machine woke sleeping processes too late meanwhile: on a busy machine that, and
not the program, decides the tail.
"""

import argparse
import os

import numpy as np

from benchmarks.live.live_latency import measure_live_latency


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    middle = options.seconds / 2
    for people in (1, 6):
        for _ in range(options.repeat):
            run = measure_live_latency(options.seconds, people=people, dead=(middle, middle + 2.0))
            median, p90, p99 = np.percentile(run.latency, (50, 90, 99))
            timers = np.percentile(run.late_timers, 99)
            print(
                f"{people} persons ({run.people} found), {len(run.latency)} frames, {run.missing} missing, "
                f"{run.returns} return: median {median:.1f}, p90 {p90:.1f}, p99 {p99:.1f}, largest "
                f"{run.latency.max():.1f} ms; timers late by {timers:.1f} ms (p99); load {os.getloadavg()[0]:.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
