"""Gross faults by trial: each suspected fault is undone, and the fault is believed when the views then agree.

The measure is how far key points lie from the triangulation of all views (or, for silhouettes, how far the planes that
touch the person differ between two views), in shares of the person's size, so that it holds for any image size.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hypose.cameras.camera import Camera, CameraRig, triangulate
from hypose.geometry import Array, se3_inverse

CONVENTIONS: tuple[tuple[str, Callable[[Camera], Array]], ...] = (
    ("64 times too large (Qualisys coefficients of another version, divided by 64)", lambda c: c.distortion / 64),
    ("64 times too small (Qualisys coefficients must not be divided by 64)", lambda c: c.distortion * 64),
    ("of the opposite sign", lambda c: -c.distortion),
    ("those of images that are already undistorted", lambda c: np.zeros(5)),
)


@dataclass(frozen=True)
class Trial:
    """One suspected fault undone. kind, views (indices) and words as in a Finding; rig and pixels (C, T, K, 3) after
    the cure."""

    kind: str
    views: tuple[int, ...]
    words: str
    cure: str
    rig: CameraRig
    pixels: Array


def mirrored_names(names: Sequence[str]) -> list[int]:
    """Column of the same key point on the other side of the body."""
    other = {"left": "right", "right": "left"}
    out = []
    for k, n in enumerate(names):
        side, _, rest = n.partition("_")
        twin = f"{other[side]}_{rest}" if side in other else n
        out.append(list(names).index(twin) if twin in names else k)
    return out


def disagreement(rig: CameraRig, pixels: Array, views: Sequence[int] = ()) -> float:
    """Mean over `views` (default all) of the median distance of their key points (C, T, K, 3; distorted px) from the
    triangulation, in shares of the person's size, at most 10.

    Triangulated from the other views when two are left, so that a bad view does not spoil the points it is judged by;
    else from all. Points behind a camera count as far away."""
    c = len(rig)
    judged = list(views) or list(range(c))
    others = [k for k in range(c) if k not in judged]
    by = others if len(others) > 1 else list(range(c))
    needed = sorted({*judged, *by})
    uv, confidence = undistorted(CameraRig(tuple(rig[k] for k in needed)), pixels[needed])
    at = {k: i for i, k in enumerate(needed)}
    rows = [at[k] for k in by]
    flat, seen = uv.reshape(len(needed), -1, 2), np.where(confidence > 0.3, confidence, 0.0).reshape(len(needed), -1)
    points, _ = triangulate(CameraRig(tuple(rig[k] for k in by)), flat[rows], seen[rows])
    known = np.isfinite(points).all(1)
    out = []
    for k in judged:
        size = float(sizes(pixels[k : k + 1])[0])
        use = known & (seen[at[k]] > 0)
        if use.sum() > 20 and size > 0:
            distance = np.linalg.norm(rig[k].project_pinhole(points[use]) - flat[at[k]][use], axis=1)
            out.append(min(float(np.median(np.nan_to_num(distance, nan=1e6))) / size, 10.0))
    return float(np.mean(out)) if out else float("nan")


def undistorted(rig: CameraRig, pixels: Array) -> tuple[Array, Array]:
    """Key points (C, T, K, 3) as undistorted px (C, T, K, 2) and confidence (C, T, K), 0 where that is impossible."""
    uv = np.stack([c.undistort_points(p[..., :2]) for c, p in zip(rig, pixels, strict=True)])
    far = 20 * rig.sizes.max()
    fine = np.isfinite(uv).all(-1) & (np.abs(np.nan_to_num(uv)) < far).all(-1)
    return np.where(fine[..., None], uv, 0.0), np.where(fine, pixels[..., 2], 0.0)


def sizes(pixels: Array) -> Array:
    """(C,) median over the frames of the person's longer side in px; 0 where nobody is seen."""
    out = np.zeros(len(pixels))
    for c, view in enumerate(pixels):
        found = [np.ptp(p[p[:, 2] > 0.3, :2], axis=0).max() for p in view if (p[:, 2] > 0.3).sum() > 5]
        out[c] = float(np.median(found)) if found else 0.0
    return out


def trials(
    rig: CameraRig, pixels: Array, names: Sequence[str], stored: Sequence[tuple[int, int] | None]
) -> Iterator[Trial]:
    """All suspected faults of a rig and key points (C, T, K, 3), undone one at a time. stored: size of each view's
    stored images, None when unknown."""
    twin = mirrored_names(names)
    for c, camera in enumerate(rig):
        w, h = camera.size
        p = pixels[c]
        mirrored = (np.array([w - 1.0, 0.0]) + np.array([-1.0, 1.0]) * p[..., :2], twin)
        cure = f"mirror the video back (ffmpeg -i IN -vf hflip OUT), or calibrate {camera.name} from mirrored images"
        yield _with(rig, pixels, c, "mirrored", mirrored, "its images are mirrored", cure)
        turned = (np.array([w - 1.0, h - 1.0]) - p[..., :2], None)
        cure = f"turn the video back (ffmpeg -i IN -vf hflip,vflip OUT), or calibrate {camera.name} from turned images"
        yield _with(rig, pixels, c, "turned", turned, "its images are upside down", cure)
        flipped = (np.array([0.0, h - 1.0]) + np.array([1.0, -1.0]) * p[..., :2], twin)
        cure = "flip the video back (ffmpeg -i IN -vf vflip OUT)"
        yield _with(rig, pixels, c, "mirrored", flipped, "its images are flipped top to bottom", cure)
        yield from _sizes(rig, pixels, c, stored[c])
    for a, b in itertools.combinations(range(len(rig)), 2):
        order = np.arange(len(rig))
        order[[a, b]] = b, a
        words = f"its video is that of camera {rig.names[b]} and the other way round"
        cure = (
            f'exchange them: give the view of {rig.names[a]} camera = "{rig.names[b]}", '
            f'that of {rig.names[b]} camera = "{rig.names[a]}"'
        )
        yield Trial("swapped", (a, b), words, cure, rig, pixels[order])
    if len(rig) > 2:
        for shift in (1, len(rig) - 1):
            order = np.roll(np.arange(len(rig)), shift)
            words = "the videos belong to other cameras: their order is shifted by one"
            cure = 'give each view its camera = "..." in recording.toml'
            yield Trial("swapped", tuple(range(len(rig))), words, cure, rig, pixels[order])
    yield from _all_views(rig, pixels, twin)
    inverse = CameraRig(tuple(replace(c, camera_from_world=se3_inverse(c.camera_from_world)) for c in rig))
    words = "the poses are those of the cameras in the world, not of the world in the cameras"
    yield Trial("inverted", (), words, "invert every camera's rotation and translation", inverse, pixels)
    for words, coefficients in CONVENTIONS:
        if any(np.abs(c.distortion).max(initial=0) > 0 for c in rig):
            changed = CameraRig(tuple(replace(c, distortion=coefficients(c)) for c in rig))
            cure = "correct the distortion coefficients of the calibration file, or calibrate the lenses again"
            yield Trial("distortion", (), f"its distortion coefficients are {words}", cure, changed, pixels)
    for c, camera in enumerate(rig):
        for words, coefficients in CONVENTIONS:
            if np.abs(camera.distortion).max(initial=0) > 0:
                cameras = list(rig)
                cameras[c] = replace(camera, distortion=coefficients(camera))
                cure = f"correct the distortion coefficients of {camera.name}, or calibrate its lens again"
                words = f"its distortion coefficients are {words}"
                yield Trial("distortion", (c,), words, cure, CameraRig(tuple(cameras)), pixels)


def _all_views(rig: CameraRig, pixels: Array, twin: list[int]) -> Iterator[Trial]:
    """The same done to all views at once."""
    last = (rig.sizes - 1.0)[:, None, None]
    for kind, words, turn, cure in (
        ("mirrored", "all images are mirrored", (True, False), "mirror the videos back (ffmpeg -i IN -vf hflip OUT)"),
        ("turned", "all images are upside down", (True, True), "turn the videos back (ffmpeg -vf hflip,vflip)"),
        (
            "flipped",
            "the key points' y counts from the bottom of the images (or all videos are flipped)",
            (False, True),
            "write y as the image's height minus y",
        ),
    ):
        points = pixels.copy()
        points[..., :2] = np.where(turn, last - pixels[..., :2], pixels[..., :2])
        points = np.where(pixels[..., 2:] > 0, points, 0.0)
        # what is mirrored shows the other side; what only counts the other way has its names right
        points = points[:, :, twin] if kind == "mirrored" else points
        yield Trial(kind, tuple(range(len(rig))), words, cure, rig, points)


def _with(
    rig: CameraRig,
    pixels: Array,
    c: int,
    kind: str,
    new: tuple[Array, list[int] | None],
    words: str,
    cure: str,
) -> Trial:
    points = pixels.copy()
    points[c, ..., :2] = new[0]
    points[c] = np.where(pixels[c, ..., 2:] > 0, points[c], 0.0)
    if new[1] is not None:
        points[c] = points[c][:, new[1]]
    return Trial(kind, (c,), words, cure, rig, points)


def _sizes(rig: CameraRig, pixels: Array, c: int, stored: tuple[int, int] | None) -> Iterator[Trial]:
    """Key points of images of another size than calibrated: scaled, or cut out of them."""
    camera = rig[c]
    w, h = camera.size
    xy = pixels[c, ..., :2]
    known = stored is not None and tuple(stored) != (w, h)
    factors = [(w / stored[0], h / stored[1])] if known and stored is not None else []
    if not known:
        factors = [(s, s) for s in (0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0)]
    for fx, fy in factors:
        new = ((xy + 0.5) * np.array([fx, fy]) - 0.5, None)
        if known and stored is not None:
            words = (
                f"its key points are in pixels of the stored {stored[0]} x {stored[1]} images, not of the calibrated"
            )
        else:
            words = f"its key points are in pixels of images {1 / fx:.2f} times the calibrated size"
        cure = 'set keypoint_pixels = "image" in recording.toml'
        yield _with(rig, pixels, c, "scaled", new, words + f" {w} x {h}", cure)
    if known and stored is not None and (stored[0] < w or stored[1] < h):
        dw, dh = max(w - stored[0], 0), max(h - stored[1], 0)
        places = {(x, y) for x in (0.0, 0.5, 1.0) for y in (0.0, 0.5, 1.0)}
        for x, y in sorted(places):
            dx, dy = round(x * dw), round(y * dh)
            if (dx, dy) == (0, 0):
                continue
            words = f"its images were cut: {dx} px are missing at the left and {dy} px at the top"
            cure = f"subtract ({dx}, {dy}) from the principal point of {camera.name} and give its size as {stored}"
            yield _with(rig, pixels, c, "cropped", (xy + np.array([dx, dy]), None), words, cure)
            # or the loader has stretched them to the calibrated size
            back = (xy + 0.5) * np.array([stored[0] / w, stored[1] / h]) - 0.5 + np.array([dx, dy])
            yield _with(rig, pixels, c, "cropped", (back, None), words, cure)


def best_trial(
    rig: CameraRig, pixels: Array, names: Sequence[str], stored: Sequence[tuple[int, int] | None], every: int = 4
) -> tuple[Trial | None, float, float]:
    """The trial after which the views concerned agree best, and their disagreement before and after it (shares of the
    person's size), judged on every n-th frame. Trials that leave all views together worse are not believed."""
    few = pixels[:, ::every]
    all_before = disagreement(rig, few)
    before: dict[tuple[int, ...], float] = {}
    scored: list[tuple[float, float, int]] = []
    for k, trial in enumerate(trials(rig, few, names, stored)):
        if trial.views not in before:
            before[trial.views] = disagreement(rig, few, trial.views)
        scored.append((disagreement(trial.rig, trial.pixels, trial.views), before[trial.views], k))
    # the camera that is worst off is looked at first: its fault disturbs the others
    worst = max((b for _, b, _ in scored), default=0.0)
    order = sorted(scored, key=lambda x: x[0] / max(x[1], 1e-6))
    for after, was, k in order[:6]:
        if was < 0.5 * worst and after > 0.2 * was:
            continue
        trial = next(itertools.islice(trials(rig, pixels, names, stored), k, None))
        if disagreement(trial.rig, trial.pixels[:, ::every]) < all_before:
            return trial, was, after
    return None, all_before, all_before
