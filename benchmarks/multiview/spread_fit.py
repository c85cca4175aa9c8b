"""Fits a and b of `hypose.tracking.covariance_calibration` to errors on scenes, and measures what regions then hold."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as fisher

from benchmarks.bench_report import Row
from benchmarks.multiview.error_scenes import CAMERAS, EVIDENCE, Tracked
from hypose.body.default_body import JOINT_NAMES
from hypose.body.joint_angles import ANGLE_NAMES
from hypose.body.motion import TAILS, Motion, region_reach
from hypose.geometry import Array
from hypose.synthetic.metrics import EVALUATED
from hypose.tracking.covariance_calibration import (
    apart_factors,
    beyond_usual,
    kind_of,
    with_angle_variance,
    with_fitted_joints,
)
from hypose.tracking.error_model import as_mixture
from hypose.tracking.joint_features import views_apart
from hypose.tracking.refinement import LUMBAR_SD, joint_group

ASSET = Path(__file__).parents[2] / "hypose" / "assets" / "spread.json"
LEVELS = np.arange(0.1, 0.96, 0.05)
_A = np.geomspace(0.1, 2.4, 24)
_C_M, _C_RAD = np.linspace(0.0, 6.0, 61), np.radians(np.linspace(0.0, 900.0, 61))
"""per m by which views contradict each other beyond what is usual"""
_B_M = np.linspace(0.0, 0.025, 26)
_B_RAD = np.radians(np.linspace(0.0, 16.0, 33))
_WRONG_M = 0.1
UNSEEN = 1.02
"""Bodies that were not fitted to are off by so much more: with 1 regions of 90 % of key points that err like a
detector's held 86 % on twelve seeds left out, 88 % of the seeds fitted to."""
SLACK, _NATS = {"silhouettes": 0.0, "keypoints": 0.03, "both": 0.03, "depth": 0.0}, 0.15
"""What counts as equally good a fit: where key points are seen in pictures larger than those of scenes, V is half of
what scenes have, and errors are not. And what a nat of likelihood counts in it, beside shares. Chosen with the seeds
1218 to 1229 and balancing in sight."""
LEAST_A = {"silhouettes": 0.0, "keypoints": 0.7, "both": 0.0, "depth": 0.0}
"""Scenes have few joints that no key point shows, whose V is large, and fits to the others would shrink it to half; by
nothing else are those told to be wrong."""
NEUTRAL_DEG = 5.0
"""1 sd: how far a person's pelvis, as anatomists measure its tilt, lies from that of the template in the same posture:
30 pelves that stood alike had 13 degrees, sd 5 (Preece et al. 2008, doi 10.1179/106698108790818459)."""
HIP_FAULT_M, HIP_LEVER_M = 0.04 / 3**0.5, 0.1
"""m per axis: detectors' hips lie 30 to 50 mm from the joints' centres, always to the same side (Needham et al. 2021,
doi 10.1038/s41598-021-00212-x); m: from the hips' axis up to the lumbar joint of the body. No scene shows this, since
its points are the joints."""
TILTED = ("pelvis_tilt", "hip_flexion", "lumbar_extension")
Pairs = Mapping[str, tuple[float, float]]


def pelvis_floor(evidence: str) -> float:
    """rad, 1 sd: what hip flexion, pelvis tilt and lumbar extension cannot be better known than. Where key points turn
    the pelvis, a fault of the hips does so too, held by the prior of the spine's flexion."""
    neutral = np.radians(NEUTRAL_DEG)
    if evidence in ("silhouettes", "depth"):
        return float(neutral)
    turned = np.arctan2(HIP_FAULT_M, HIP_LEVER_M)
    return float(np.hypot(neutral, (turned**-2 + LUMBAR_SD**-2) ** -0.5))


def squares(away: Array, covariance: Array, a: float, b: float) -> Array:
    """(N,) Mahalanobis distances squared of away (N, 3) with a^2 V + b^2 I."""
    c = a**2 * covariance + b**2 * np.eye(3)
    return np.einsum("na,na->n", away, np.linalg.solve(c, away[..., None])[..., 0])


def level_error(m2: Array, dimensions: int, normal: bool = False) -> float:
    """Mean over LEVELS of |share inside the region - level|; normal: were the errors normally distributed."""
    reach = chi2.ppf(LEVELS, dimensions) if normal else _reach(dimensions) ** 2
    return float(np.abs(np.searchsorted(np.sort(m2), reach) / max(len(m2), 1) - LEVELS).mean())


@cache
def _reach(dimensions: int) -> Array:
    return np.asarray(region_reach(LEVELS, dimensions))


Families = Sequence[tuple[Array, Array, Array]]
"""Errors, what is said of them, and the variance that comes on top, of each family of clips."""


def fit_joint(families: Families, slack: float = 0.0, least_a: float = 0.0) -> tuple[float, float]:
    """a, b (m) of one kind of joint, from (N, 3) m from the estimates to the truth, covariances (N, 3, 3), and what
    comes on top (N, 3, 3) m^2, of each family; see `_least`."""
    made = []
    for away, covariance, more in families:
        few = slice(None, None, max(1, len(away) // 4000))
        values, vectors = np.linalg.eigh(covariance[few])
        along = np.einsum("nab,nac,ncb->nb", vectors, more[few], vectors)  # along the axes of V
        made.append((np.einsum("nab,na->nb", vectors, away[few]) ** 2, values, along + 1e-9))
    return _least(made, _B_M, slack, least_a)


def fit_angle(families: Families, slack: float = 0.0) -> tuple[float, float]:
    """a, b (rad, or m) of one kind of angle, from errors, sd, and what comes on top (N,) rad^2, of each family."""
    few = [slice(None, None, max(1, len(off) // 4000)) for off, _, _ in families]
    made = [
        (off[k, None] ** 2, sd[k, None] ** 2, more[k, None] + 1e-12)
        for k, (off, sd, more) in zip(few, families, strict=True)
    ]
    return _least(made, _B_RAD, slack)


def _least(families: Families, tried: Array, slack: float, least_a: float = 0.0) -> tuple[float, float]:
    """a, and b of those tried, from squares of errors, variances (N, d) along their axes, and what comes on top, of
    each family: with the least of level error, what the worst family is off at 90 %, and _NATS of surprise.

    No family pays for another, and likelihood keeps what tells sure frames from others. Of fits within the slack of the
    best that with the largest b."""
    scored = []
    for a in _A[_A >= least_a]:
        for b in tried:
            level, tail, nats = 0.0, 0.0, 0.0
            for square, variance, more in families:
                v = a**2 * variance + b**2 + more
                m2 = (square / v).sum(1)
                level += level_error(m2, v.shape[1]) / len(families)
                nats += _surprise(m2, v) / len(families)
                tail = max(tail, abs(covered(m2, v.shape[1]) - 0.9))
            scored.append((level + tail + _NATS * nats, a, b))
    enough = min(scored)[0] + slack
    b, _, a = max((b, -score, a) for score, a, b in scored if score <= enough)
    return float(UNSEEN * a), float(UNSEEN * b)


def _surprise(m2: Array, variances: Array) -> float:
    """Mean negative log-likelihood, but for a constant, by the law of `region_reach`."""
    d = variances.shape[1]
    share = (d / TAILS) * fisher.ppf(0.9, d, TAILS) / chi2.ppf(0.9, d)
    return float(0.5 * (np.log(variances).sum(1) + (TAILS + d) * np.log1p(share * m2)).mean())


def family_of(c: Tracked) -> str:
    """cameras: captured motion through the cameras of a recording, points that err like a detector's; of depth, the
    number of sensors; scenes: all others. Scenes that are not spoilt are too few to be a family: their persons' offsets
    would set b."""
    return c.case if c.evidence == "depth" else "cameras" if c.case in CAMERAS else "scenes"


def fit_spread(clips: Sequence[Tracked], without: int | None = None) -> dict[str, dict[str, Any]]:
    """What the asset holds, from all seeds but one: what bodies share is learnt from as many as there are, and judged
    on the one left out. Joints that are not evaluated get their neighbours'. An evidence without clips is left out."""
    out: dict[str, dict[str, Any]] = {"joints": {}, "angles": {}, "apart": {}}
    for evidence in (*EVIDENCE, "depth"):
        own = [c for c in clips if c.evidence == evidence and c.seed != without and plain_enough(c)]
        if not own:
            continue
        usual, calm = float("inf"), own
        if evidence == "silhouettes":
            usual = float(np.median([views_apart(c.audit) for c in own]))
            calm = [c for c in own if beyond(c, usual) <= usual]
        families = [[c for c in calm if family_of(c) == f] for f in sorted({family_of(c) for c in calm})]
        joints: dict[str, tuple[float, float]] = {}
        for kind in dict.fromkeys(kind_of(JOINT_NAMES[j]) for j in EVALUATED):
            joints[kind] = fit_joint([_of_kind(f, kind) for f in families], SLACK[evidence], LEAST_A[evidence])
        for kind, like in (("spine", "pelvis"), ("chest", "neck"), ("clavicle", "shoulder")):
            joints[kind] = joints[like]
        out["joints"][evidence] = joints
        kinds = dict.fromkeys(kind_of(n) for n in ANGLE_NAMES)
        angles = {kind: fit_angle([_of_angle(f, kind) for f in families], SLACK[evidence]) for kind in kinds}
        for kind in TILTED:
            angles[kind] = angles[kind][0], max(angles[kind][1], pelvis_floor(evidence))
        out["angles"][evidence] = angles
        if len(calm) < len(own):
            rough = [c for c in own if beyond(c, usual) > usual]
            out["apart"][evidence] = {"all": (usual, *_apart(rough, usual, joints, angles))}
    return out


def beyond(c: Tracked, usual: float) -> float:
    """m, beyond what is usual; as `hypose.tracking.covariance_calibration.beyond_usual`."""
    return float(np.sqrt(max(views_apart(c.audit) ** 2 - usual**2, 0.0)))


def _apart(clips: Sequence[Tracked], usual: float, joints: Pairs, angles: Pairs) -> tuple[float, float]:
    """c of joints and of angles, from clips whose views contradict each other."""

    def best(tried: Array, squares_of: Callable[[float], Array], dimensions: int) -> float:
        scored = [(squares_of(c), c) for c in tried.tolist()]
        return min((level_error(m, dimensions) + abs(covered(m, dimensions) - 0.9), c) for m, c in scored)[1]

    def of_joints(factor: float) -> Array:
        return np.concatenate(
            [joint_squares(c, j, joints, factor * beyond(c, usual)) for c in clips for j in EVALUATED]
        )

    def of_angles(factor: float) -> Array:
        return np.concatenate([angle_squares(c, angles, factor * beyond(c, usual)) for c in clips])

    return best(_C_M, of_joints, 3), best(_C_RAD, of_angles, 1)


def as_told(c: Tracked) -> Motion:
    """The clip's motion with the covariances, and the sd of its angles, that a user is told."""
    p, joints = c.judged()
    beyond = beyond_usual(c.audit, c.evidence)
    m = with_fitted_joints(replace(c.motion, error_probability=p, low_confidence_joints=joints), c.evidence, beyond)
    if m.angle_sd is not None:
        m = with_angle_variance(m, m.angle_sd.astype(np.float64) ** 2, c.evidence, beyond)
    return as_mixture(m)


def joint_squares(c: Tracked, joint: int, pairs: Pairs, more: float) -> Array:
    """(T,) distances squared of a joint, in its covariances by pairs a, b, and more m of sd."""
    a, b = pairs.get(kind_of(JOINT_NAMES[joint]), (1.0, 0.0))
    around = c.motion.joint_covariance[:, joint] + (c.on_top[:, joint] + more**2 * np.eye(3)) / a**2
    return squares(c.away[:, joint], around, a, b)


def angle_squares(c: Tracked, pairs: Pairs, more: float) -> Array:
    """(T * A,) the same of the angles, more rad of sd; none of a clip whose angles are not known."""
    if c.angles is None or c.motion.angle_sd is None:
        return np.zeros(0)
    a, b = np.array([pairs.get(kind_of(n), (1.0, 0.0)) for n in ANGLE_NAMES]).T
    variance = a**2 * c.motion.angle_sd.astype(np.float64) ** 2 + b**2 + more**2 + c.elsewhere[1]
    return (c.angles**2 / (variance + 1e-12)).ravel()


def plain_enough(c: Tracked) -> bool:
    """Is the body roughly right? Where it is not, P says so, and no region is meant to hold. With depth all count: an
    arm that the only sensor does not see is a guess, and its region has to say so."""
    return c.evidence == "depth" or float((c.error[:, EVALUATED] > _WRONG_M).mean()) < 0.1


def _of_kind(clips: Sequence[Tracked], kind: str) -> tuple[Array, Array, Array]:
    which = [j for j in EVALUATED if kind_of(JOINT_NAMES[j]) == kind]
    away = np.concatenate([c.away[:, which].reshape(-1, 3) for c in clips])
    around = np.concatenate([c.motion.joint_covariance[:, which].reshape(-1, 3, 3) for c in clips]).astype(np.float64)
    more = np.concatenate([c.on_top[:, which].reshape(-1, 3, 3) for c in clips])
    known = np.isfinite(around).all((1, 2))
    return away[known], around[known], more[known]


def _of_angle(clips: Sequence[Tracked], kind: str) -> tuple[Array, Array, Array]:
    which = [k for k, n in enumerate(ANGLE_NAMES) if kind_of(n) == kind]
    known = [c for c in clips if c.angles is not None and c.motion.angle_sd is not None]
    if not known:
        return np.zeros(1), np.ones(1), np.zeros(1)
    off, sd, more = [], [], []
    for c in known:
        assert c.angles is not None and c.motion.angle_sd is not None
        off.append(c.angles[:, which].ravel())
        sd.append(np.asarray(c.motion.angle_sd[:, which], np.float64).ravel())
        more.append(c.elsewhere[1][:, which].ravel())
    return np.concatenate(off), np.concatenate(sd), np.concatenate(more)


def covered(m2: Array, dimensions: int, level: float = 0.9) -> float:
    """Share of distances squared inside the region of a level."""
    return float((m2 <= chi2.ppf(level, dimensions)).mean()) if len(m2) else float("nan")


def held_rows(m2: Array, dimensions: int, case: str) -> list[Row]:
    """Rows of what regions hold, from distances squared: coverage_90; ece, mean over LEVELS of |share inside - level|
    by `region_reach`; ece_normal, the same for who takes the covariances for those of normal distributions."""
    return [
        Row("coverage_90", case, covered(m2, dimensions), "1", n=len(m2)),
        Row("ece", case, level_error(m2, dimensions), "1", n=len(m2)),
        Row("ece_normal", case, level_error(m2, dimensions, normal=True), "1", n=len(m2)),
    ]


def judged_by_seed(clips: Sequence[Tracked]) -> dict[str, dict[str, tuple[float, float]]]:
    """{evidence: {group: (share inside the 90 % region, level error)}}, each seed by the fit of the others; the groups
    of joints, all of them, and 'angles'."""
    found: dict[str, dict[str, list[Array]]] = {e: {} for e in (*EVIDENCE, "depth")}
    for seed in sorted({c.seed for c in clips}):
        fitted = fit_spread(clips, seed)
        for c in clips:
            if c.seed != seed or not plain_enough(c):
                continue
            own, by = (
                found[c.evidence],
                {what: fitted[what][c.evidence] for what in fitted if c.evidence in fitted[what]},
            )
            usual, by_joint, by_angle = by.get("apart", {}).get("all", apart_factors(c.evidence))
            for j in EVALUATED:
                m2 = joint_squares(c, j, by["joints"], by_joint * beyond(c, usual))
                for group in (joint_group(JOINT_NAMES[j]), "all"):
                    own.setdefault(group, []).append(m2)
            own.setdefault("angles", []).append(angle_squares(c, by["angles"], by_angle * beyond(c, usual)))
    sizes = {"angles": 1}
    return {e: {g: _judged(np.concatenate(m), sizes.get(g, 3)) for g, m in by.items()} for e, by in found.items()}


def _judged(m2: Array, dimensions: int) -> tuple[float, float]:
    return covered(m2, dimensions), level_error(m2, dimensions)


def write_spread(clips: Sequence[Tracked]) -> None:
    """Fits, and writes the asset; an evidence without clips keeps what it has."""
    kept = json.loads(ASSET.read_text(encoding="utf-8"))
    found = {what: {**kept[what], **by} for what, by in fit_spread(clips).items()}
    rounded = {
        what: {e: {k: [round(x, 5) for x in values] for k, values in v.items()} for e, v in by.items()}
        for what, by in found.items()
    }
    ASSET.write_text(json.dumps(rounded, indent=1) + "\n", encoding="utf-8")
