"""Fits the spread of depth (`hypose.tracking.covariance_calibration`) and how likely a joint is wrong before depth
cameras (`hypose.tracking.error_model.DepthErrorModel`) to errors on simulated recordings, and judges both.

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
from scipy.optimize import minimize
from scipy.stats import chi2

from benchmarks.bench_report import BenchOptions
from benchmarks.depth_sensors.depth_tracking import RATE, SENSORS, aligned, scene_of
from benchmarks.multiview.error_scenes import angles_of, as_curved, true_angles
from benchmarks.multiview.spread_fit import ASSET, TILTED, fit_angle, fit_joint, pelvis_floor, squares
from benchmarks.synthetic.depth_frames import depth_frames
from hypose.body.default_body import JOINT_NAMES
from hypose.body.joint_angles import ANGLE_NAMES
from hypose.geometry import Array
from hypose.pipeline.run import track_source
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.metrics import EVALUATED
from hypose.tracking.covariance_calibration import kind_of
from hypose.tracking.error_features import clip_features
from hypose.tracking.error_model import (
    GROUPS,
    TRUNK,
    WRONG_M,
    DepthErrorModel,
    error_models,
    groups_of,
    probability,
)

TRAINED = range(100)
"""seeds that may be trained on; the benchmark reports others"""
CASES = ("one", "two", "three")
_FEW = 5
_GROUP = groups_of(JOINT_NAMES)
DOUBT_ASSET = ASSET.with_name("depth_doubt.json")
_LIKE = (("spine", "pelvis"), ("chest", "neck"), ("clavicle", "shoulder"))


@dataclass(frozen=True)
class DepthClip:
    """One tracked clip. away (T, J, 3) m, angles (T, A) rad: estimate and truth apart; around (T, J, 3, 3) m^2, sd (T,
    A) rad: what the curvature says of them; odds (T, J): log-odds by silhouettes that a joint is wrong."""

    case: str
    seed: int
    away: Array
    around: Array
    angles: Array
    sd: Array
    odds: Array


def collect(folder: Path, case: str, seed: int, data: Path, seconds: float = 2.0) -> DepthClip:
    """Tracks the scene of a case ('one', 'two', 'three') and a seed, and keeps it in the folder, unless it is there."""
    path = folder / f"{case}-{seed}.pkl"
    if path.exists():
        return pickle.loads(path.read_bytes())  # noqa: S301 - its own file
    folder.mkdir(parents=True, exist_ok=True)
    options = BenchOptions(False, 1, data, lambda stage, done, total: None, seed, None)
    scene = scene_of(seed, SENSORS[case], seconds, options)
    result = track_source(FrameList(list(depth_frames(scene)), RATE), RATE, TrackOptions(seed=seed))
    m = as_curved(result.motion, "depth")
    assert m.angle_sd is not None and result.audit is not None and result.one_by_one is not None
    features = clip_features(m, result.body.joints(result.one_by_one), result.audit)
    odds = error_models()["depth"].log_odds(features, JOINT_NAMES)
    off = angles_of(m) - true_angles(scene)[: len(m)]
    off = (off + np.pi) % (2 * np.pi) - np.pi
    away = scene.joints[: len(m)] - aligned(m, scene)
    around, sd = m.joint_covariance.astype(np.float64), m.angle_sd.astype(np.float64)
    clip = DepthClip(case, seed, away, around, off, sd, odds)
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
                    np.zeros(sum(c.away[:, own, 0].size for c in f)),
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
                    np.zeros(sum(c.sd[:, own].size for c in f)),
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


def fit_doubt(clips: Sequence[DepthClip]) -> DepthErrorModel:
    """Level of each case and group, and slope of each group, by maximum likelihood; every case weighs the same. Of
    joints of the trunk, of which hardly one is ever wrong, what silhouettes say is left as it is."""
    level, slope = np.zeros((len(CASES), len(GROUPS))), np.ones(len(GROUPS))
    for g in range(TRUNK, len(GROUPS)):
        families = [_odds_and_wrong([c for c in clips if c.case == case], g) for case in CASES]

        def unlikely(v: Array, families: Sequence[tuple[Array, Array]] = families) -> float:
            told = [v[k] + v[-1] * x for k, (x, _) in enumerate(families)]
            # as if one more joint at log-odds of -4 were wrong, and one right: some cases hardly have any
            prior = 2 * np.logaddexp(0, v[:-1] + v[-1] * -4.0) - (v[:-1] + v[-1] * -4.0)
            fits = [(np.logaddexp(0, t) - y * t).sum() + p for t, (_, y), p in zip(told, families, prior, strict=True)]
            return float(sum(f / len(y) for f, (_, y) in zip(fits, families, strict=True)))

        found = minimize(unlikely, np.r_[np.zeros(len(CASES)), 1.0], method="BFGS").x
        level[:, g], slope[g] = found[:-1], found[-1]
    return DepthErrorModel(level, slope)


def _odds_and_wrong(clips: Sequence[DepthClip], group: int) -> tuple[Array, Array]:
    """Log-odds by silhouettes of all joints of a group, and 1 for those that are wrong, else 0."""
    own = [j for j in EVALUATED if _GROUP[j] == group]
    wrong = [(np.linalg.norm(c.away[:, own], axis=-1) > WRONG_M).ravel() for c in clips]
    return np.concatenate([c.odds[:, own].ravel() for c in clips]), np.concatenate(wrong).astype(np.float64)


def told_and_true(clips: Sequence[DepthClip], fitted: DepthErrorModel) -> dict[str, tuple[float, ...]]:
    """{case and group: (share of joints that are wrong, mean of what is told, expected calibration error in ten bins)},
    of what silhouettes say as well, after what the fit says."""
    out = {}
    for row, case in enumerate(CASES):
        for g in range(TRUNK, len(GROUPS)):
            odds, wrong = _odds_and_wrong([c for c in clips if c.case == case], g)
            said = [wrong.mean()]
            for p in (probability(fitted.level[row, g] + fitted.slope[g] * odds), probability(odds)):
                bins = np.minimum((10 * p).astype(int), 9)
                off = sum(abs((p - wrong)[bins == k].sum()) for k in range(10)) / len(p)
                said += [p.mean(), off]
            out[f"{case} {GROUPS[g]}"] = tuple(round(float(x), 4) for x in said)
    return out


def write_doubt(clips: Sequence[DepthClip]) -> None:
    """Fits how likely joints are wrong, and writes the asset."""
    doubt = fit_doubt(clips)
    told = {"level": doubt.level.round(3).tolist(), "slope": doubt.slope.round(3).tolist()}
    DOUBT_ASSET.write_text(json.dumps(told) + "\n", encoding="utf-8")


def write_spread(clips: Sequence[DepthClip]) -> None:
    """Fits the spread, and writes the asset; what it holds of other evidence stays."""
    kept = json.loads(ASSET.read_text(encoding="utf-8"))
    for what, own in fit(clips).items():
        kept[what]["depth"] = {kind: [round(x, 5) for x in pair] for kind, pair in own.items()}
    ASSET.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
