"""Fits a and b of `hypose.tracking.fitted_spread` to errors on scenes, and measures what regions then hold."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from benchmarks.multiview.doubt_scenes import EVIDENCE, Tracked
from hypose.body.joint_angles import ANGLE_NAMES
from hypose.body.ready_bodies import JOINT_NAMES
from hypose.geometry import Array
from hypose.synthetic.metrics import EVALUATED
from hypose.tracking.fitted_spread import kind_of
from hypose.tracking.pose_covariance import joint_group

ASSET = Path(__file__).parents[2] / "hypose" / "assets" / "spread.json"
LEVELS = np.arange(0.1, 0.96, 0.05)
_A = np.geomspace(0.1, 4.0, 28)
_B_M = np.linspace(0.0, 0.04, 21)
_B_RAD = np.radians(np.linspace(0.0, 16.0, 33))
_LEFT_OUT_M = 0.1
"""m: what is so far off is wrong, which P tells and no ellipsoid; it does not count here"""
UNSEEN = 1.08
"""Bodies that were not fitted to are off by so much more: with 1 regions of 90 % held 86 to 88 % on seeds left out."""
PELVIS = {"silhouettes": 6.0, "keypoints": 14.0, "both": 12.0}
"""Degrees, 1 sd: two hip points and an outline do not fix the pelvis' tilt, and no scene shows it, as its points are
the joints. On the real clip of a man who balances, hip flexion by these lies 7, 23 and 18 degrees from that by OpenSim,
so hip flexion, pelvis tilt and lumbar extension are no better known than this."""
_TILTED = ("pelvis_tilt", "hip_flexion", "lumbar_extension")
Pairs = dict[str, tuple[float, float]]


def squares(away: Array, covariance: Array, a: float, b: float) -> Array:
    """(N,) Mahalanobis distances squared of away (N, 3) with a^2 V + b^2 I."""
    c = a**2 * covariance + b**2 * np.eye(3)
    return np.einsum("na,na->n", away, np.linalg.solve(c, away[..., None])[..., 0])


def level_error(m2: Array, dimensions: int) -> float:
    """Mean over LEVELS of |share inside - level|."""
    inside = np.sort(chi2.cdf(m2, dimensions))
    return float(np.abs(np.searchsorted(inside, LEVELS) / max(len(inside), 1) - LEVELS).mean())


def fit_joint(away: Array, covariance: Array) -> tuple[float, float]:
    """a, b (m) of one kind of joint with the least level error; among equals the smaller region."""
    few = slice(None, None, max(1, len(away) // 1500))
    away, covariance = away[few], covariance[few]
    values, vectors = np.linalg.eigh(covariance)
    turned = np.einsum("nab,na->nb", vectors, away) ** 2
    return _least([(a, b, (turned / (a**2 * values + b**2 + 1e-9)).sum(1)) for a in _A for b in _B_M], 3)


def fit_angle(off: Array, sd: Array) -> tuple[float, float]:
    """a, b (rad, or m) of one kind of angle: off, sd (N,)."""
    return _least([(a, b, off**2 / (a**2 * sd**2 + b**2 + 1e-12)) for a in _A for b in _B_RAD], 1)


def _least(tried: Sequence[tuple[float, float, Array]], dimensions: int) -> tuple[float, float]:
    # the tail counts as well: a likelihood keeps a region from being right on average only
    scored = []
    for a, b, m2 in tried:
        inside = float((m2 <= chi2.ppf(0.9, dimensions)).mean())
        scored.append((level_error(m2, dimensions) + abs(inside - 0.9), a, b))
    _, a, b = min(scored)
    return float(UNSEEN * a), float(UNSEEN * b)


def fit_spread(clips: Sequence[Tracked], without: int | None = None) -> dict[str, dict[str, Pairs]]:
    """What the asset holds, from all seeds but one: what bodies share is learnt from as many as there are, and judged
    on the one left out. Joints that are not evaluated get their neighbours'."""
    out: dict[str, dict[str, Pairs]] = {"joints": {}, "angles": {}}
    for evidence in EVIDENCE:
        own = [c for c in clips if c.evidence == evidence and c.seed != without and plain_enough(c)]
        joints: Pairs = {}
        for kind in dict.fromkeys(kind_of(JOINT_NAMES[j]) for j in EVALUATED):
            away, covariance = _of_kind(own, kind)
            joints[kind] = fit_joint(away, covariance)
        for kind, like in (("spine", "pelvis"), ("chest", "neck"), ("clavicle", "shoulder")):
            joints[kind] = joints[like]
        out["joints"][evidence] = joints
        angles = {kind: fit_angle(*_of_angle(own, kind)) for kind in dict.fromkeys(kind_of(n) for n in ANGLE_NAMES)}
        for kind in _TILTED:
            angles[kind] = angles[kind][0], max(angles[kind][1], float(np.radians(PELVIS[evidence])))
        out["angles"][evidence] = angles
    return out


def plain_enough(c: Tracked) -> bool:
    """Is the body roughly right? Where it is not, P says so, and no region is meant to hold."""
    return float((c.error[:, EVALUATED] > _LEFT_OUT_M).mean()) < 0.1


def _of_kind(clips: Sequence[Tracked], kind: str) -> tuple[Array, Array]:
    which = [j for j in EVALUATED if kind_of(JOINT_NAMES[j]) == kind]
    away = np.concatenate([c.away[:, which].reshape(-1, 3) for c in clips])
    around = np.concatenate([c.motion.joint_covariance[:, which].reshape(-1, 3, 3) for c in clips]).astype(np.float64)
    good = (np.linalg.norm(away, axis=1) < _LEFT_OUT_M) & np.isfinite(around).all((1, 2))
    return away[good], around[good]


def _of_angle(clips: Sequence[Tracked], kind: str) -> tuple[Array, Array]:
    which = [k for k, n in enumerate(ANGLE_NAMES) if kind_of(n) == kind]
    known = [c for c in clips if c.angles is not None and c.motion.angle_sd is not None]
    if not known:
        return np.zeros(1), np.ones(1)
    off, sd = [], []
    for c in known:
        assert c.angles is not None and c.motion.angle_sd is not None
        off.append(c.angles[:, which].ravel())
        sd.append(np.asarray(c.motion.angle_sd[:, which], np.float64).ravel())
    return np.concatenate(off), np.concatenate(sd)


def covered(m2: Array, dimensions: int, level: float = 0.9) -> float:
    """Share of distances squared inside the region of a level."""
    return float((m2 <= chi2.ppf(level, dimensions)).mean()) if len(m2) else float("nan")


def judged_by_seed(clips: Sequence[Tracked]) -> dict[str, dict[str, tuple[float, float]]]:
    """{evidence: {group: (share inside the 90 % region, level error)}}, each seed by the fit of the others; the groups
    of joints, all of them, and 'angles'."""
    found: dict[str, dict[str, list[Array]]] = {e: {} for e in EVIDENCE}
    for seed in sorted({c.seed for c in clips}):
        fitted = fit_spread(clips, seed)
        for c in clips:
            if c.seed != seed or not plain_enough(c):
                continue
            own = found[c.evidence]
            for j in EVALUATED:
                name = JOINT_NAMES[j]
                around = c.motion.joint_covariance[:, j].astype(np.float64)
                m2 = squares(c.away[:, j], around, *fitted["joints"][c.evidence][kind_of(name)])
                for group in (joint_group(name), "all"):
                    own.setdefault(group, []).append(m2)
            if c.angles is not None and c.motion.angle_sd is not None:
                for k, name in enumerate(ANGLE_NAMES):
                    a, b = fitted["angles"][c.evidence][kind_of(name)]
                    variance = a**2 * c.motion.angle_sd[:, k].astype(np.float64) ** 2 + b**2 + 1e-12
                    own.setdefault("angles", []).append(c.angles[:, k] ** 2 / variance)
    sizes = {"angles": 1}
    return {e: {g: _judged(np.concatenate(m), sizes.get(g, 3)) for g, m in by.items()} for e, by in found.items()}


def _judged(m2: Array, dimensions: int) -> tuple[float, float]:
    return covered(m2, dimensions), level_error(m2, dimensions)


def write_spread(clips: Sequence[Tracked]) -> None:
    """Fits, and writes the asset."""
    found = fit_spread(clips)
    rounded = {
        what: {e: {k: [round(a, 3), round(b, 5)] for k, (a, b) in v.items()} for e, v in by.items()}
        for what, by in found.items()
    }
    ASSET.write_text(json.dumps(rounded, indent=1) + "\n", encoding="utf-8")
