"""Fits the spread of depth (`hypose.tracking.fitted_spread`) to errors on simulated recordings, and judges it.

Unlike with masks, what is far off counts too: an arm that the only sensor does not see is a guess, and its region has
to say so. Clips before one, two and three sensors are families, none of which pays for another.
"""

from __future__ import annotations

import json
import pickle
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from benchmarks.bench_report import BenchOptions
from benchmarks.depth_sensors.depth_tracking import RATE, SENSORS, aligned, scene_of
from benchmarks.multiview.doubt_scenes import angles_of, true_angles
from benchmarks.multiview.spread_fit import ASSET, TILTED, fit_angle, fit_joint, pelvis_floor, squares
from hypose.body.joint_angles import ANGLE_NAMES
from hypose.body.ready_bodies import JOINT_NAMES
from hypose.geometry import Array
from hypose.pipeline.run import TrackOptions, track_source
from hypose.pipeline.track_loop import FrameList
from hypose.synthetic.metrics import EVALUATED
from hypose.tracking.doubt import without_mixture
from hypose.tracking.fitted_spread import as_curved, kind_of

TRAINED = range(100)
"""seeds that may be trained on; the benchmark reports others"""
_FEW = 5
_LIKE = (("spine", "pelvis"), ("chest", "neck"), ("clavicle", "shoulder"))


@dataclass(frozen=True)
class DepthClip:
    """One tracked clip. away (T, J, 3) m, angles (T, A) rad: estimate and truth apart; around (T, J, 3, 3) m^2, sd (T,
    A) rad: what the curvature says of them."""

    case: str
    seed: int
    away: Array
    around: Array
    angles: Array
    sd: Array


def collect(folder: Path, case: str, seed: int, data: Path, seconds: float = 2.0) -> DepthClip:
    """Tracks the scene of a case ('one', 'two', 'three') and a seed, and keeps it in the folder, unless it is there."""
    path = folder / f"{case}-{seed}.pkl"
    if path.exists():
        return pickle.loads(path.read_bytes())  # noqa: S301 - its own file
    folder.mkdir(parents=True, exist_ok=True)
    options = BenchOptions(False, 1, data, lambda stage, done, total: None, seed, None)
    scene = scene_of(seed, SENSORS[case], seconds, options)
    result = track_source(FrameList(list(scene.frames()), RATE), RATE, TrackOptions(seed=seed))
    m = as_curved(without_mixture(result.motion), "depth")
    assert m.angle_sd is not None
    off = angles_of(m) - true_angles(scene)[: len(m)]
    off = (off + np.pi) % (2 * np.pi) - np.pi
    away = scene.joints[: len(m)] - aligned(m, scene)
    clip = DepthClip(case, seed, away, m.joint_covariance.astype(np.float64), off, m.angle_sd.astype(np.float64))
    path.write_bytes(pickle.dumps(clip))
    return clip


def fit(clips: Sequence[DepthClip]) -> dict[str, dict[str, tuple[float, float]]]:
    """{"joints" or "angles": {kind: (a, b)}} of clips."""
    families = [[_thinned(c) for c in clips if c.case == case] for case in sorted({c.case for c in clips})]
    joints, angles = {}, {}
    for kind in dict.fromkeys(kind_of(JOINT_NAMES[j]) for j in EVALUATED):
        own = [j for j in EVALUATED if kind_of(JOINT_NAMES[j]) == kind]
        joints[kind] = fit_joint(
            [
                (
                    np.concatenate([c.away[:, own].reshape(-1, 3) for c in f]),
                    np.concatenate([c.around[:, own].reshape(-1, 3, 3) for c in f]),
                )
                for f in families
            ]
        )
    for kind, like in _LIKE:
        joints[kind] = joints[like]
    for kind in dict.fromkeys(kind_of(n) for n in ANGLE_NAMES):
        own = [k for k, n in enumerate(ANGLE_NAMES) if kind_of(n) == kind]
        a, b = fit_angle(
            [
                (
                    np.concatenate([c.angles[:, own].ravel() for c in f]),
                    np.concatenate([c.sd[:, own].ravel() for c in f]),
                )
                for f in families
            ]
        )
        angles[kind] = a, max(b, pelvis_floor("silhouettes")) if kind in TILTED else b
    return {"joints": joints, "angles": angles}


def _thinned(c: DepthClip) -> DepthClip:
    """Every few frames: neighbours err together."""
    few = slice(None, None, _FEW)
    return replace(c, away=c.away[few], around=c.around[few], angles=c.angles[few], sd=c.sd[few])


def held(clips: Sequence[DepthClip], fitted: dict[str, dict[str, tuple[float, float]]]) -> tuple[float, float]:
    """Shares of joints, and of angles, that lie in their 90 % regions."""
    joints, angles = [], []
    for c in clips:
        for j in EVALUATED:
            joints.append(squares(c.away[:, j], c.around[:, j], *fitted["joints"][kind_of(JOINT_NAMES[j])]))
        for k, n in enumerate(ANGLE_NAMES):
            a, b = fitted["angles"][kind_of(n)]
            angles.append(c.angles[:, k] ** 2 / (a**2 * c.sd[:, k] ** 2 + b**2))
    inside = [np.concatenate(m) <= chi2.ppf(0.9, d) for m, d in ((joints, 3), (angles, 1))]
    return float(inside[0].mean()), float(inside[1].mean())


def held_left_out(clips: Sequence[DepthClip], folds: int = 4) -> dict[str, tuple[float, float]]:
    """{case: `held`} of seeds that were left out of the fit, in so many parts."""
    seeds = sorted({c.seed for c in clips})
    found: dict[str, list[tuple[float, float]]] = {}
    for k in range(folds):
        out = set(seeds[k::folds])
        fitted = fit([c for c in clips if c.seed not in out])
        for case in {c.case for c in clips}:
            own = [c for c in clips if c.seed in out and c.case == case]
            if own:
                found.setdefault(case, []).append(held(own, fitted))
    return {case: (float(np.mean(v, 0)[0]), float(np.mean(v, 0)[1])) for case, v in sorted(found.items())}


def write(clips: Sequence[DepthClip]) -> None:
    """Fits, and writes the asset; what it holds of other evidence stays."""
    kept = json.loads(ASSET.read_text(encoding="utf-8"))
    for what, own in fit(clips).items():
        kept[what]["depth"] = {kind: [round(x, 5) for x in pair] for kind, pair in own.items()}
    ASSET.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
