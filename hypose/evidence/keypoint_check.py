"""Find key points and cameras that were misread, by undoing each suspected fault as a trial.

Normal errors of a detector and a calibration are some pixels; a wrong picture size, a wrong axis, exchanged cameras or
mirrored pictures give errors as large as the person. A fault is confirmed where the views agree far better after it was
undone. The measure is the distance of key points from their triangulation, in shares of the person's size, so that it
is valid for any image size.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.cameras.camera import PARALLEL, Camera, CameraRig, triangulate, widest_angle
from hypose.evidence.keypoints import other_sides, person_size
from hypose.geometry import Array, se3_inverse

SeenT = TypeVar("SeenT")


@dataclass(frozen=True)
class Trial(Generic[SeenT]):
    """Suspected fault of a calibration or its views, with the cameras and observations after it was undone as a
    trial.

    kind: kind of the fault, as in `Finding.kind`.
    cure: next step for the user, a sentence.
    views: indices of the affected views; empty for all.
    words: description of the fault.
    rig: cameras after the cure.
    seen: observations of the views after the cure: key points (C, T, K, 3), mask tracks or depth maps.
    """

    kind: str
    views: tuple[int, ...]
    words: str
    cure: str
    rig: CameraRig
    seen: SeenT


CONVENTIONS: tuple[tuple[str, Callable[[Camera], Array]], ...] = (
    ("64 times too large (Qualisys coefficients of another version, divided by 64)", lambda c: c.distortion / 64),
    ("64 times too small (Qualisys coefficients must not be divided by 64)", lambda c: c.distortion * 64),
    ("of the opposite sign", lambda c: -c.distortion),
    ("those of images that are already undistorted", lambda c: np.zeros(5)),
)


# Kind, words, factors of x and y about the middle of the picture, cure.
_TURNS = (
    ("mirrored", "mirrored", (-1.0, 1.0), "mirror the video back (ffmpeg -i IN -vf hflip OUT)"),
    ("turned", "upside down", (-1.0, -1.0), "turn the video back (ffmpeg -i IN -vf hflip,vflip OUT)"),
    ("mirrored", "flipped top to bottom", (1.0, -1.0), "flip the video back (ffmpeg -i IN -vf vflip OUT)"),
)
# The same of all images at once: kind, words, factor of y, cure.
_TURNS_OF_ALL = (
    ("mirrored", "all images are mirrored", 1.0, "mirror the videos back (ffmpeg -i IN -vf hflip OUT)"),
    ("turned", "all images are upside down", -1.0, "turn the videos back (ffmpeg -vf hflip,vflip)"),
)
# Usual factors between the sizes of stored and calibrated images.
_SCALES = (0.25, 1 / 3, 0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0, 3.0, 4.0)
# Tried places of a cropped image: the part of the missing columns and rows that is missing at its left and top.
_PLACES = (0.0, 0.5, 1.0)


def geometric_trials(
    rig: CameraRig, seen: SeenT, turned: Callable[[int, Array], SeenT], ordered: Callable[[NDArray[np.int64]], SeenT]
) -> Iterator[Trial[SeenT]]:
    """Yield trials for mirrored or rotated images of one camera, exchanged views of two cameras, and inverted poses.

    seen: observations of the views.
    turned: function of view and factors (2,) that multiplies the view's positions about the picture's middle.
    ordered: function that puts the views into another order.
    """
    for c, camera in enumerate(rig):
        for kind, words, factor, cure in _TURNS:
            cure = f"{cure}, or calibrate {camera.name} from such images"
            yield Trial(kind, (c,), f"its images are {words}", cure, rig, turned(c, np.array(factor)))
    for a, b in itertools.combinations(range(len(rig)), 2):
        order = np.arange(len(rig))
        order[[a, b]] = b, a
        words = f"its video is that of camera {rig.names[b]} and the other way round"
        cure = f'exchange camera = "{rig.names[a]}" and camera = "{rig.names[b]}" in recording.toml'
        yield Trial("swapped", (a, b), words, cure, rig, ordered(order))
    inverse = CameraRig(tuple(replace(c, camera_from_world=se3_inverse(c.camera_from_world)) for c in rig))
    words = "the poses are those of the cameras in the world, not of the world in the cameras"
    yield Trial("inverted", (), words, "invert every camera's rotation and translation", inverse, seen)


def sizes(pixels: Array) -> Array:
    """Compute the person's size in each view: the longer side of the box around the key points, median over the
    frames.

    pixels: (C, T, K, 3) px, and confidence.
    Returns: (C,) px; 0 where no person is seen.
    """
    out = np.zeros(len(pixels))
    for c, view in enumerate(pixels):
        found = [size for p in view if (size := person_size(p, least=6)) > 0]
        out[c] = float(np.median(found)) if found else 0.0
    return out


def disagreement(rig: CameraRig, pixels: Array, views: Sequence[int] = ()) -> float:
    """Compute the disagreement of key points with their triangulation, in shares of the person's size, at most 10.

    It is the mean over `views` of the median distance in px. Points behind a camera count as far away.

    pixels: (C, T, K, 3) distorted px, and confidence.
    views: views that are judged; all by default.
    Why: points are triangulated from the other views when these are at least two, so that a bad view does not affect
        the points by which it is judged; else from all.
    """
    every = list(range(len(rig)))
    judged = list(views) or every
    others = [k for k in every if k not in judged]
    by = others if len(others) > 1 else every
    uv, confidence = undistorted(rig, pixels)
    flat, seen = uv.reshape(len(rig), -1, 2), np.where(confidence > 0.3, confidence, 0.0).reshape(len(rig), -1)
    points, _ = triangulate(CameraRig(tuple(rig[k] for k in by)), flat[by], seen[by])
    known, out = np.isfinite(points).all(1), list[float]()
    for k, size in zip(judged, sizes(pixels[judged]).tolist(), strict=True):
        use = known & (seen[k] > 0)
        if use.sum() > 20 and size > 0:
            distance = np.linalg.norm(rig[k].project_pinhole(points[use]) - flat[k][use], axis=1)
            out.append(min(float(np.median(np.nan_to_num(distance, nan=1e6))) / size, 10.0))
    return float(np.mean(out)) if out else float("nan")


def undistorted(rig: CameraRig, pixels: Array) -> tuple[Array, Array]:
    """Remove the lens distortion from key points.

    pixels: (C, T, K, 3) distorted px, and confidence.
    Returns: (C, T, K, 2) px, and confidence (C, T, K), 0 where the point cannot be undistorted.
    """
    uv = np.stack([c.undistort_points(p[..., :2]) for c, p in zip(rig, pixels, strict=True)])
    far = 20 * rig.sizes.max()
    fine = np.isfinite(uv).all(-1) & (np.abs(np.nan_to_num(uv)) < far).all(-1)
    return np.where(fine[..., None], uv, 0.0), np.where(fine, pixels[..., 2], 0.0)


def triangulated(rig: CameraRig, pixels: Array, least_sine: float = 0.0) -> Array:
    """Triangulate key points (C, T, K, 3), distorted px and confidence, to (T, K, 3), m; NaN where missing.

    least_sine: points at which no two rays have an angle with this sine are NaN, too.
    """
    uv, confidence = undistorted(rig, pixels)
    uv, seen = uv.reshape(len(rig), -1, 2), np.where(confidence > 0.3, confidence, 0.0).reshape(len(rig), -1)
    world, _ = triangulate(rig, uv, seen)
    world[widest_angle(rig, uv, seen) < least_sine] = np.nan
    return world.reshape(*pixels.shape[1:3], 3)


def trials(
    rig: CameraRig, pixels: Array, names: Sequence[str], stored: Sequence[tuple[int, int] | None]
) -> Iterator[Trial[Array]]:
    """Yield all suspected faults of a rig and its key points, each one undone.

    pixels: (C, T, K, 3) distorted px, and confidence.
    names: K names of the key points.
    stored: width and height of each view's stored images, px; None where unknown.
    """
    twin, every = other_sides(names), tuple(range(len(rig)))

    def moved(
        views: Sequence[int],
        factor: ArrayLike = 1.0,
        offset: ArrayLike = 0.0,
        *,
        turned: bool = False,
        sides: bool = False,
        transposed: bool = False,
    ) -> Array:
        """Scale the pixels of views about the middle of their pictures (turned), else about the corner."""
        out = pixels.copy()
        for c in views:
            centre = (np.array(rig[c].size) - 1) / 2 if turned else np.full(2, -0.5)
            xy = pixels[c, ..., 1::-1] if transposed else pixels[c, ..., :2]
            xy = centre + np.asarray(factor) * (xy - centre) + np.asarray(offset)
            out[c, ..., :2] = np.where(pixels[c, ..., 2:] > 0, xy, 0.0)
            out[c] = out[c][:, twin] if sides else out[c]
        return out

    # a mirrored picture exchanges left and right; a reversed axis alone does not
    yield from geometric_trials(
        rig,
        pixels,
        lambda c, factor: moved((c,), factor, turned=True, sides=bool(factor.prod() < 0)),
        lambda order: pixels[order],
    )
    known = [c for c in every if stored[c] is not None and stored[c] != rig[c].size]
    cure = 'set keypoint_pixels = "image" in recording.toml'
    for views in (*((c,) for c in every), every):
        whose = "its" if len(views) == 1 else "the"
        words = f"{whose} key points' y counts from the bottom of the images (or the videos are flipped)"
        flipped = moved(views, (1.0, -1.0), turned=True)
        yield Trial("flipped", views, words, "write y as the image's height minus y", rig, flipped)
        words = f"x and y of {whose} key points are exchanged"
        yield Trial("transposed", views, words, "exchange them in the files", rig, moved(views, transposed=True))
        for s in _SCALES if not set(views) & set(known) else ():
            words = f"{whose} key points are in pixels of images {1 / s:.3g} times the calibrated size"
            yield Trial("scaled", views, words, cure, rig, moved(views, s))
    for c in known:
        (w, h), (given_w, given_h) = rig[c].size, stored[c] or rig[c].size
        words = (
            f"its key points are in pixels of the stored {given_w} x {given_h} images, not of the calibrated {w} x {h}"
        )
        yield Trial("scaled", (c,), words, cure, rig, moved((c,), (w / given_w, h / given_h)))
        cut_x, cut_y = max(w - given_w, 0), max(h - given_h, 0)
        for left, top in sorted({(round(x * cut_x), round(y * cut_y)) for x in _PLACES for y in _PLACES} - {(0, 0)}):
            words = f"its images were cut: {left} px are missing at the left and {top} px at the top"
            cut = (
                f"subtract ({left}, {top}) from the principal point of {rig.names[c]} and give its size as {stored[c]}"
            )
            # or the loader has stretched them to the calibrated size
            for factor in ((1.0, 1.0), (given_w / w, given_h / h)):
                yield Trial("cropped", (c,), words, cut, rig, moved((c,), factor, (left, top)))
    for shift in (1, len(rig) - 1) if len(rig) > 2 else ():
        words = "the videos belong to other cameras: their order is shifted by one"
        order = 'give each view its camera = "..." in recording.toml'
        yield Trial("swapped", every, words, order, rig, pixels[np.roll(np.arange(len(rig)), shift)])
    for kind, words, y, cure in _TURNS_OF_ALL:
        turned_back = moved(every, (-1.0, y), turned=True, sides=kind == "mirrored")
        yield Trial(kind, every, words, cure, rig, turned_back)
    lenses = [c for c in every if np.abs(rig[c].distortion).max(initial=0) > 0]
    for views in ((), *((c,) for c in lenses)) if lenses else ():
        whose = rig.names[views[0]] if views else "the calibration file"
        lens = f"correct the distortion coefficients of {whose}, or calibrate the lens again"
        for words, coefficients in CONVENTIONS:
            cameras = [
                replace(k, distortion=coefficients(k)) if c in (views or every) else k for c, k in enumerate(rig)
            ]
            words = f"its distortion coefficients are {words}"
            yield Trial("distortion", views, words, lens, CameraRig(tuple(cameras)), pixels)


def best_trial(
    rig: CameraRig,
    seen: SeenT,
    trials: Callable[[CameraRig, SeenT], Iterator[Trial[SeenT]]],
    measure: Callable[[CameraRig, SeenT, Sequence[int]], float],
    few: Callable[[SeenT], SeenT],
) -> tuple[Trial[SeenT] | None, float, float]:
    """Find the trial after which the affected views agree best.

    Trials that make the agreement of all views together worse are rejected.

    seen: observations of the views: key points (C, T, K, 3) or mask tracks.
    trials: function that yields the suspected faults of cameras and observations, each one undone.
    measure: function of cameras, observations and view indices (none: all) that gives the disagreement of these views
        with the others, in shares of the person's size.
    few: function that selects the frames by which trials are compared.
    Returns: the trial (None without one), and the disagreement before and after it.
    """
    some = few(seen)
    all_before = measure(rig, some, ())
    before = cache(lambda views: measure(rig, some, views))
    scored = [(measure(t.rig, t.seen, t.views), before(t.views), k) for k, t in enumerate(trials(rig, some))]
    # the camera with the largest disagreement is tested first, because its fault affects the others
    worst = max((b for _, b, _ in scored), default=0.0)
    order = sorted(scored, key=lambda x: x[0] / max(x[1], 1e-6))
    for after, was, k in order[:6]:
        if was < 0.5 * worst and after > 0.2 * was:
            continue
        trial = next(itertools.islice(trials(rig, seen), k, None))
        if measure(trial.rig, few(trial.seen), ()) < all_before:
            return trial, was, after
    return None, all_before, all_before


# ---- key points of a file ----

_FRAMES = 24
_FINE = 0.06  # largest disagreement of points that were read rightly
_DOUBTFUL = 0.015  # disagreement from which misreadings are tried
_BETTER = 0.35  # largest share of the disagreement that a misreading may leave to be accepted
_CONFIDENT = 0.2
_MISREADINGS = ("scaled", "flipped", "mirrored", "turned", "transposed")


def misread(people: Sequence[Sequence[Array | None]], names: Sequence[str], rig: CameraRig) -> str | None:
    """Find the misreading that explains why the views' key points contradict each other.

    rig: the calibrated cameras.
    people: per view and frame the people (P, K, 3), px of the calibrated, distorted cameras; None: no file.
    names: names of the K points.
    Returns: a part of a sentence that names the error; None where nothing is wrong, it cannot be known, or the
        calibration is wrong, which other checks report.
    """
    points = _one_person(people, len(names), len(rig))
    if points is None or len(rig) < 2:
        return None
    plain = disagreement(rig, points)
    if plain > _DOUBTFUL:

        def tried(cameras: CameraRig, seen: Array) -> Iterator[Trial[Array]]:
            return trials(cameras, seen, names, [None] * len(cameras))

        trial, _, after = best_trial(rig, points, tried, lambda r, p, _: disagreement(r, p), lambda p: p)
        if trial is not None and after < min(_FINE, _BETTER * plain):
            where = f"view {rig.names[trial.views[0]]}" if len(trial.views) == 1 else "all views"
            return f"{where}: {trial.words}" if trial.kind in _MISREADINGS else None
    world = triangulated(rig, points, PARALLEL)  # not by two cameras that face each other, for example
    if plain < 2 * _FINE and sides_exchanged(world, names):
        return "the person is mirrored: y counts upwards, or left and right are exchanged in the names"
    return None


def _one_person(people: Sequence[Sequence[Array | None]], count: int, views: int) -> Array | None:
    """Select frames (C, T, K, 3) in which two or more views see exactly one person; None when there are too few.

    people: per view and frame the people (P, K, 3), None where there are none.
    count: K.
    views: number of views.
    """
    rows = [[None if p is None else p[t] for p in people] for t in range(max((len(p) for p in people), default=0))]
    single = [[None if p is None or len(p) != 1 else p[0] for p in row] for row in rows]
    # several people in all frames: the tallest, which is mostly the nearest, in all views
    tallest = [[None if p is None else max(p, key=person_size, default=None) for p in row] for row in rows]
    for chosen, fewest in ((single, 2), (tallest, max(views, 3))):
        usable = [
            row for row in chosen if sum(p is not None and person_size(p, _CONFIDENT, 6) > 0 for p in row) >= fewest
        ]
        if len(usable) >= 3:
            some = np.unique(np.linspace(0, len(usable) - 1, min(_FRAMES, len(usable))).astype(int))
            points = [[np.zeros((count, 3)) if p is None else p for p in usable[i]] for i in some]
            return np.array(points).transpose(1, 0, 2, 3)
    return None


_TRUNK = ("left_shoulder", "left_hip", "right_shoulder", "right_hip")
# Points in front of others of the same part.
_FRONTS = (
    (("nose",), ("left_ear", "right_ear")),
    (("left_big_toe",), ("left_heel",)),
    (("right_big_toe",), ("right_heel",)),
)


def sides_exchanged(world: Array, names: Sequence[str]) -> bool:
    """Test whether nose and toes point backwards relative to left and right, in more than 85 % of the frames.

    world: (T, K, 3) m; NaN where missing.
    names: K names of the key points.
    Returns: False also where neither face nor feet are known in ten places and frames.
    """
    at = {n: i for i, n in enumerate(names)}

    def of(*wanted: str) -> Array:
        return np.mean([world[:, at[n]] for n in wanted], 0)

    if not all(n in at for n in _TRUNK):
        return False
    left_to_right = of(*_TRUNK[2:]) - of(*_TRUNK[:2])
    forwards = np.cross(of(*_TRUNK[::2]) - of(*_TRUNK[1::2]), left_to_right)  # up x right
    known = [(front, back) for front, back in _FRONTS if all(n in at for n in (*front, *back))]
    found = np.array([((of(*front) - of(*back)) * forwards).sum(-1) for front, back in known])
    found = found[np.isfinite(found) & (np.abs(found) > 0)]
    return len(found) >= 10 and float((found < 0).mean()) > 0.85
