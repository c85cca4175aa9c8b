"""The logistic fit of `hypose.tracking.error_model`, and how well it tells wrong joints on scenes that it was not
fitted to.

The weights' signs are held: more bare mask never speaks for a joint. What is learnt of some motions must hold for
others, and a weight that only a chance of these motions has turned around does not.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.stats import rankdata

from benchmarks.multiview.error_scenes import ALL, JUDGES, Tracked
from hypose.body.default_body import JOINT_NAMES
from hypose.body.motion import Motion
from hypose.geometry import Array
from hypose.synthetic.metrics import EVALUATED
from hypose.tracking.error_model import (
    BY_ITSELF,
    FEATURES,
    GROUPS,
    MOST_SD,
    OF_CLIP,
    WRONG_M,
    ErrorModel,
    clip_features,
    error_level,
    error_models,
    groups_of,
    needs_review,
    probability,
    within_clip,
)

ASSET = Path(__file__).parents[2] / "hypose" / "assets" / "error_model.json"
_NAMES = tuple(JOINT_NAMES[j] for j in EVALUATED)
_GROUP = groups_of(_NAMES)
_ARMS = np.isin(_GROUP, [GROUPS.index("elbows"), GROUPS.index("wrists")])
_NEGATIVE = ("exposed", "exposed_second", "points_agree")
_CLIP = tuple(f"{n}_of_clip" for n in OF_CLIP)
"""The same for all joints of a clip: neither sign speaks for itself."""
_POINTS = ("sd_around", "accel", "points_around", "points_worst", "points_all", "points_agree", "points_contested")
_MASKED = ("sd_around", "accel", "still", "bare_second", "exposed", "exposed_second")
USED = {
    "silhouettes": (*_MASKED, "bare_relative", "outside", "loose", "exchanged", *_CLIP),
    "keypoints": _POINTS,
    "both": (*_MASKED, *_POINTS[2:], "bare", "outside", "loose"),
    "depth": (*_MASKED, "bare", "outside", "exchanged"),
}
"""Features that the joints of an evidence are judged by. Taken away one after the other from 44, each time the one
without which joints of motions left out, all kinds of evidence together, were judged best (seeds 600 to 609 and 993 to
1010). Of masks, bare_relative and cost_of_clip came back: they judge arms better where nothing else is wrong."""
_RIDGE = 30.0
_RIDGE_CLIP = 100.0
"""Of _CLIP, which are as many as there are clips, however many their frames."""
_PARTS = 8
"""of the seeds, each left out once"""
_WHOLE, _LESS = 0.1, 0.25
"""Clips in which more than the share _WHOLE of the joint-frames is wrong weigh less: a body that is wrong as a whole is
easily told, and its frames are many. Chosen, as _RIDGE, by motions left out of the seeds trained on. What joints are
worth in such clips is told by `in_clip`, where all weigh the same."""
GOOD_FLAGGED = {
    "silhouettes": (0.01, 0.045, 0.015),
    "keypoints": (0.005, 0.03, 0.01),
    "both": (0.005, 0.045, 0.01),
    "depth": (0.005, 0.045, 0.01),
}
"""Share of good joint-frames of trunk, arms and legs that may be flagged on seeds that were left out. Of key points
half of the clips are spoilt, so that of good ones far fewer are."""
_AS = (0, 0, 0, 1, 1, 2, 2)  # trunk, arms or legs by the group
LEAST_P = {"silhouettes": 0.1, "keypoints": 0.08, "both": 0.04, "depth": 0.1}
"""What is less likely wrong than that is not doubtful, however few are flagged; of both, joints are wrong a tenth as
often as from silhouettes."""


@dataclass(frozen=True)
class Rows:
    """Joint-frames of one evidence. x (N, J, F) features, error (N, J) m, case (N,) and seed (N,) they are of; clip
    (N,): the number of the clip that they are judged in; plain (N,): nothing was spoilt; whole (N,): of a whole clip,
    and not a frame by itself."""

    x: Array
    error: Array
    case: NDArray[np.str_]
    seed: NDArray[np.int64]
    clip: NDArray[np.int64]
    plain: NDArray[np.bool_]
    whole: NDArray[np.bool_]

    @property
    def usual(self) -> NDArray[np.bool_]:
        """(N,) nothing but the person in the masks, through the right cameras."""
        return ~np.isin(self.case, [n for n, c in ALL.items() if not c.usual])

    def take(self, rows: NDArray[np.bool_]) -> Rows:
        """Some of them."""
        return Rows(*(getattr(self, f.name)[rows] for f in fields(self)))


ALONE = (7, 22)
"""Frames that are trained on by themselves as well: recordings of one frame are judged too."""


def rows_of(clips: Sequence[Tracked], evidence: str, alone: Sequence[int] = ()) -> Rows:
    """Of the clips tracked from one evidence; alone: frames that count by themselves as well."""
    own = [c for c in clips if c.evidence == evidence]
    parts: list[tuple[Tracked, slice, bool]] = [(c, slice(None), True) for c in own]
    parts += [(c, slice(t, t + 1), False) for c in own for t in alone if t < len(c.error)]
    x = [_features(c, at) for c, at, _ in parts]
    count = [len(v) for v in x]
    return Rows(
        np.concatenate(x),
        np.concatenate([c.error[at, EVALUATED] for c, at, _ in parts]),
        np.repeat([c.case for c, _, _ in parts], count),
        np.repeat([c.seed for c, _, _ in parts], count),
        np.repeat(np.arange(len(parts)), count),
        np.repeat([c.kind == "plain" for c, _, _ in parts], count),
        np.repeat([whole for _, _, whole in parts], count),
    )


def _features(c: Tracked, at: slice) -> Array:
    m = c.motion
    if at != slice(None):
        assert m.poses is not None
        m = Motion(
            *(m.skeleton, m.times[at], m.joints[at], m.poses[at], m.joint_covariance[at], m.lost[at]),
            *(m.extrapolated[at], m.n_views[at], m.cost[at]),
        )
    return clip_features(m, c.body.joints(c.one_by_one[at]), c.audit[at])[:, EVALUATED]


def fit(rows: Rows, evidence: str) -> ErrorModel:
    """The model of an evidence, fitted to all rows given. Thresholds come from what is said of
    each seed when it is fitted to the others: of its own rows a fit is surer than it may be. They come from clips
    through the right cameras without things in the masks: what else there is says so itself, and may be flagged more
    often."""
    model = _weights(rows, evidence)
    p, seeds = said(model, rows), np.unique(rows.seed)
    if len(seeds) > 2:
        for k in range(min(_PARTS, len(seeds))):
            own = np.isin(rows.seed, seeds[k::_PARTS])
            p[own] = said(_weights(rows.take(~own), evidence), rows.take(own))
    # what of a body that is wrong as a whole is right by chance may be flagged as well
    some = rows.whole & ~_wholly_wrong(rows) & rows.usual
    p, good = p[some], rows.error[some] <= WRONG_M
    threshold = [
        max(
            LEAST_P[evidence],
            float(np.quantile(p[:, g == _GROUP][good[:, g == _GROUP]], 1 - GOOD_FLAGGED[evidence][_AS[g]])),
        )
        for g in range(len(GROUPS))
    ]
    return replace(model, threshold=np.array(threshold))


def _weights(rows: Rows, evidence: str) -> ErrorModel:
    on, flat = np.isin(FEATURES, USED[evidence]), rows.x.reshape(-1, len(FEATURES))
    middle, scale = np.where(on, flat.mean(0), 0.0), np.where(on, np.maximum(flat.std(0), 1e-3), 1.0)
    wrong = rows.error > WRONG_M
    weights, offset = np.zeros((len(GROUPS), len(FEATURES))), np.zeros(len(GROUPS))
    count = np.where(_wholly_wrong(rows), _LESS, 1.0)
    for g in range(len(GROUPS)):
        own = g == _GROUP
        # on both sides here, so that no clip far from the others turns a weight; told, it holds where it calms alone
        z = np.clip((rows.x[:, own] - middle) / scale, -MOST_SD, MOST_SD).reshape(-1, len(FEATURES))
        counts, y = np.repeat(count, np.count_nonzero(own)), wrong[:, own].ravel().astype(float)
        weights[g], offset[g] = _logistic(z, y, counts, on)
    alone = np.tile(BY_ITSELF, (len(GROUPS), 1))
    model = ErrorModel(middle, scale, weights, offset, alone, np.full(len(GROUPS), LEAST_P[evidence]))
    return replace(model, in_clip=in_clip(model, rows)) if evidence == "silhouettes" else model


def said(model: ErrorModel, rows: Rows) -> Array:
    """(N, J) P of joints in their clips."""
    odds = model.of_joints(rows.x, _NAMES)
    return probability(model.within(odds, _NAMES, _error_levels(odds, rows.clip)))


def _error_levels(odds: Array, clip: NDArray[np.int64]) -> Array:
    """(N,) of the clip that each row is of."""
    begin = np.flatnonzero(np.r_[True, np.diff(clip) != 0])  # rows of a clip follow each other
    found = [error_level(o, _NAMES) for o in np.split(odds, begin[1:])]
    return np.repeat(found, np.diff(np.r_[begin, len(clip)]))


def in_clip(model: ErrorModel, rows: Rows) -> Array:
    """(G, 6) `ErrorModel.in_clip`, by likelihood of whole clips that all weigh the same: a slope that falls where a
    clip is doubtful as a whole, and what the neighbours' say. From masks alone: with key points motions left out are
    told worse by it."""
    rows = rows.take(rows.whole)
    odds = model.of_joints(rows.x, _NAMES)
    told, wrong = within_clip(odds, _NAMES, _error_levels(odds, rows.clip)), rows.error > WRONG_M
    out = np.zeros((len(GROUPS), told.shape[-1]))
    for g in range(len(GROUPS)):
        a, y = (x[:, g == _GROUP].reshape(-1, *x.shape[2:]).astype(float) for x in (told, wrong))
        out[g] = _held(a, y, np.ones(len(y)), _IN_CLIP, np.array(BY_ITSELF))
    return out


_IN_CLIP = [(-9.0, 9.0), (-9.0, 9.0), (0.1, 2.0), (-0.5, 0.0), (0.0, 2.0), (-0.3, 0.3)]
"""Bounds of `ErrorModel.in_clip`."""


def _wholly_wrong(rows: Rows) -> NDArray[np.bool_]:
    """(N,) frames of clips in which the body as a whole is wrong."""
    clip = np.unique(np.stack([rows.case, rows.seed.astype(str)]), axis=1, return_inverse=True)[1].ravel()
    share = (rows.error > WRONG_M).mean(1)
    return np.asarray((np.bincount(clip, share) / np.bincount(clip))[clip] > _WHOLE)


def _held(a: Array, y: Array, count: Array, bounds: list[tuple[float, float]], begin: Array) -> Array:
    """(K,) the likeliest weights, within bounds, of a (N, K), whose sum is the log-odds of y (N,)."""

    def value(x: Array) -> tuple[float, Array]:
        told = a @ x
        gap = count * (probability(told) - y)
        return float((count * (np.logaddexp(0, told) - y * told)).sum()), a.T @ gap

    return np.asarray(minimize(value, begin, jac=True, method="L-BFGS-B", bounds=bounds).x)


def _logistic(z: Array, y: Array, count: Array, on: NDArray[np.bool_]) -> tuple[Array, float]:
    """Weights (F,), of held signs but those of _CLIP, zero where not on, and the offset: ridge against noise, by
    L-BFGS-B."""
    names = [n for n, used in zip(FEATURES, on, strict=True) if used]
    s = np.array([-1.0 if n in _NEGATIVE else 1.0 for n in names])
    ridge = np.array([_RIDGE_CLIP if n in _CLIP else _RIDGE for n in names])
    a = z[:, on] * s

    def value(x: Array) -> tuple[float, Array]:
        odds = a @ x[:-1] + x[-1]
        p = 1 / (1 + np.exp(-np.clip(odds, -40, 40)))
        loss = np.logaddexp(0, odds) - y * odds
        slope = count * (p - y)
        down = np.r_[a.T @ slope + ridge * x[:-1], slope.sum()]
        return float((count * loss).sum() + 0.5 * (ridge * x[:-1] ** 2).sum()), down

    rate = np.clip(y.mean(), 1e-4, 0.5)
    begin = np.r_[np.full(len(names), 0.05), np.log(rate / (1 - rate))]
    bounds = [(None if n in _CLIP else 0.0, None) for n in names] + [(None, None)]
    found = minimize(value, begin, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 500}).x
    out = np.zeros(len(on))
    out[on] = found[:-1] * s
    return out, float(found[-1])


def auroc(score: ArrayLike, wrong: ArrayLike) -> float:
    """Area under the curve: how often a wrong one has the higher score than a good one; NaN without either."""
    y, s = np.asarray(wrong, dtype=bool).ravel(), np.asarray(score, dtype=np.float64).ravel()
    n1, n0 = int(y.sum()), int((~y).sum())
    if not n1 or not n0:
        return float("nan")
    return float((rankdata(s)[y].sum() - n1 * (n1 + 1) / 2) / (n1 * n0))


def ece(p: ArrayLike, wrong: ArrayLike, bins: int = 15) -> float:
    """Expected calibration error of probabilities: mean over bins of |share wrong - mean probability|, by size."""
    p, y = np.asarray(p, dtype=np.float64).ravel(), np.asarray(wrong, dtype=np.float64).ravel()
    at = np.minimum((p * bins).astype(int), bins - 1)
    return float(sum(abs(y[at == b].mean() - p[at == b].mean()) * (at == b).mean() for b in np.unique(at)))


def figures(p: Array, error: Array, threshold: Array, evidence: str) -> dict[str, float]:
    """What P (N, J) says of errors (N, J) m at the committed thresholds (G,) of an evidence."""
    wrong, flagged = error > WRONG_M, p > threshold[_GROUP]
    arm, far = _ARMS, error > 0.15
    frame_wrong, frame_flagged = wrong[:, arm].any(1), needs_review(p, flagged, evidence)
    good_frames = ~wrong.any(1)

    def share(of: ArrayLike, where: ArrayLike) -> float:
        chosen = np.asarray(of, dtype=bool)[np.asarray(where, dtype=bool)]
        return float(chosen.mean()) if len(chosen) else float("nan")

    return {
        "wrong": float(wrong.mean()),
        "wrong arms": float(wrong[:, arm].mean()),
        "auroc": auroc(p, wrong),
        "auroc arms": auroc(p[:, arm], wrong[:, arm]),
        "recall_150 arms": share(flagged[:, arm], far[:, arm]),
        "flagged good arms": share(flagged[:, arm], ~wrong[:, arm]),
        "frames caught": share(frame_flagged, frame_wrong),
        "good frames flagged": share(frame_flagged, good_frames),
        "ece": ece(p, wrong),
        "ece arms": ece(p[:, arm], wrong[:, arm]),
    }


def of_arms(p: Array, error: Array) -> tuple[Array, NDArray[np.bool_]]:
    """P and what is wrong of the arms' joints, of (N, J) each."""
    return p[:, _ARMS], error[:, _ARMS] > WRONG_M


def left_out(rows: Rows, evidence: str) -> Array:
    """(N, J) P of every case by a model that has seen neither the case nor the judging seeds."""
    out = np.zeros(rows.error.shape)
    for case in np.unique(rows.case):
        own = rows.case == case
        model = _weights(rows.take(~own & (rows.seed < JUDGES)), evidence)
        out[own] = said(model, rows.take(own))
    return out


def report_fit(clips: Sequence[Tracked], write: bool = True) -> None:
    """Fits every evidence on the seeds below JUDGES, prints how it does on the others, and writes the asset; an
    evidence without clips keeps what it has."""
    models = dict(error_models())
    for evidence in (e for e in USED if any(c.evidence == e for c in clips)):
        rows = rows_of(clips, evidence, ALONE)
        rows = rows.take((rows.seed < JUDGES) | rows.whole)
        train, judge = rows.take(rows.seed < JUDGES), rows.take(rows.seed >= JUDGES)
        model = models[evidence] = fit(train, evidence)
        print(f"\n{evidence}: {len(train.x)} frames trained on, {len(judge.x)} judge", model.threshold.round(3))
        for name, some in (("trained on", train), ("other seeds", judge)):
            if len(some.x):
                found = figures(said(model, some), some.error, model.threshold, evidence)
                print(f"  {name}:", {k: round(v, 4) for k, v in found.items()})
        out = left_out(rows, evidence)
        rest = rows.seed >= JUDGES if (rows.seed >= JUDGES).any() else np.ones(len(out), bool)
        found = figures(out[rest], rows.error[rest], model.threshold, evidence)
        print("  motion left out:", {k: round(v, 4) for k, v in found.items()})
        for g, name in enumerate(GROUPS):
            order = np.argsort(-np.abs(model.weights[g]))[:9]
            print(f"  {name}:", {FEATURES[k]: round(float(model.weights[g, k]), 2) for k in order})
    if write:
        ASSET.write_text(json.dumps(_document(models), indent=1) + "\n", encoding="utf-8")


def _document(models: dict[str, ErrorModel]) -> dict[str, object]:
    def plain(m: ErrorModel) -> dict[str, object]:
        return {f.name: np.round(getattr(m, f.name), 4).tolist() for f in fields(m)}

    return {"features": FEATURES, "groups": GROUPS, "models": {e: plain(m) for e, m in models.items()}}
