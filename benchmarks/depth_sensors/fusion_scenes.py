"""Simulated recordings that the benchmarks of fusion share.

Seeds: settings were chosen on recordings of seeds below 1000, and one correction of the stream was prompted by the
seeds from 1000 on; what is reported comes from FRESH_SEED on, unless `--first-seed` says otherwise.
"""

from __future__ import annotations

import numpy as np

from benchmarks.bench_report import BenchOptions
from benchmarks.synthetic.sensors import SensorModel, SensorRecording
from benchmarks.synthetic.treadmill import human4d_recording, treadmill_recording
from hypose.fusion import joints as jt

FRESH_SEED = 2000
HANDS = (jt.LEFT_HAND, jt.RIGHT_HAND)


def scene_recording(scene: str, seed: int, options: BenchOptions) -> SensorRecording:
    """Scene A or B of the treadmill, or H: the run of HUMAN4D with its four cameras."""
    rng: np.random.Generator = np.random.default_rng([seed, ord(scene)])
    if scene == "H":
        return human4d_recording(options.folder("human4d_run").parent, rng)
    return treadmill_recording(scene, rng, options.data, take=seed)


def scene_settings(options: BenchOptions, seeds: range) -> dict[str, object]:
    """What a report says about its recordings."""
    model = SensorModel()
    return {
        "seeds": len(seeds),
        "first_seed": seeds.start,
        "motion": "real" if options.data is not None else "built-in",
        "sensor_model": {name: getattr(model, name) for name in model.__dataclass_fields__},
    }
