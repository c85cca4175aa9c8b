"""Diagnostics with the proportions of the person: wrong key-point set, vertical direction, left and right, units.

Bones have nearly the same proportions in all people, left and right are equal, and no bone changes its length. Points
that are read in the order of another detector violate all three in every view, so a comparison of the views cannot find
it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from hypose.body.default_body import human
from hypose.calibration.findings import INVALID, REVIEW, Finding, Limits, ViewFile
from hypose.calibration.refine_points import CameraChange
from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import EvidenceError
from hypose.evidence.keypoint_check import sides_exchanged, triangulated
from hypose.evidence.keypoints import KEYPOINT_SETS, landmark_of
from hypose.geometry import Array, unit
from hypose.tracking.subject import shape_from_keypoints

WRONG_SET, RIGHT_SET, TELLS = 0.2, 0.15, 0.4
"""Limits for a wrong key-point set. The errors of bones are logarithms of their lengths. The given set is wrong when
its bones are off by more than WRONG_SET, and another set's by less than RIGHT_SET and by less than TELLS times as much.
BODY_25 read as BODY_25B is off by 0.6 to 0.9; a detector's points in their own order by 0.03 to 0.1."""
_WRONG_WAY_SHARE = 0.8
"""Least share of the frames in which the person stands the wrong way round."""
_PAIRS = tuple(
    (f"{side}_{a}", f"{side}_{b}")
    for side in ("left", "right")
    for a, b in (
        ("shoulder", "elbow"),
        ("elbow", "wrist"),
        ("hip", "knee"),
        ("knee", "ankle"),
        ("shoulder", "hip"),
        ("ankle", "big_toe"),
        ("ankle", "heel"),
    )
) + (("left_shoulder", "right_shoulder"),)
_LEAST_BONES = 6
_NOISE_M = 0.06
_UPRIGHT = 0.5  # cosine


def wrong_set(points_world: Array, names: Sequence[str]) -> Finding | None:
    """Test whether key points belong to another set than the given one.

    points_world: (T, K, 3) m; NaN where missing.
    names: K names of the given set.
    Returns: the finding; None where the set fits.
    """
    own = _disorder(points_world, names)
    if not own > WRONG_SET:
        return None
    count, filled = len(names), np.asarray(np.isfinite(points_world).all(-1).any(0), dtype=bool)
    # a shorter set may lie in the first slots of a longer one, the others empty
    found = [
        (_disorder(points_world[:, : len(theirs)], theirs), other)
        for other, theirs in KEYPOINT_SETS.items()
        if tuple(theirs) != tuple(names) and len(theirs) <= count and not filled[len(theirs) :].any()
    ]
    best, other = min(found, default=(np.inf, ""))
    declared = next((k for k, v in KEYPOINT_SETS.items() if tuple(v) == tuple(names)), "given")
    if not best < min(RIGHT_SET, TELLS * own):
        return Finding(
            "keypoint_set",
            (),
            f"All cameras: read as {declared}, the key points make a body whose bones are off by {100 * own:.0f} % of "
            "their length, and no other set that hypose knows fits",
            "check keypoint_set in recording.toml against the detector",
            own,
        )
    slots = f" (in the first {len(KEYPOINT_SETS[other])} of {count} slots)" if len(KEYPOINT_SETS[other]) < count else ""
    return Finding(
        "keypoint_set",
        (),
        f"All cameras: the key points are those of the set {other}{slots}, not {declared}: read so, bones are off by "
        f"{100 * best:.0f} % of their length instead of {100 * own:.0f} %",
        f'set keypoint_set = "{other}" in recording.toml',
        own,
    )


def _disorder(points_world: Array, names: Sequence[str]) -> float:
    """Compute how far bone lengths deviate from those of a person, beyond the effect of noise.

    It is the mean over bones of three deviations, as logarithms: from the template's length (without a common factor),
    of left from right, and over time. NaN with too few bones.

    Why: noise makes bones longer, and short ones vary most. The part that is the same for all bones is subtracted, up
        to the noise of a detector (_NOISE_M).
    """
    template = _template(tuple(names))
    column = {n: k for k, n in enumerate(names)}
    bones = {(a, b): points_world[:, column[a]] - points_world[:, column[b]] for a, b in template}
    measured = {k: np.linalg.norm(bone[np.isfinite(bone).all(1)], axis=1) for k, bone in bones.items()}
    lengths = {k: d for k, d in measured.items() if len(d) >= 3}
    if len(lengths) < _LEAST_BONES:
        return float("nan")
    scatter = float(np.median([np.median(np.abs(d - np.median(d))) for d in lengths.values()]))
    noise = min(1.48 * scatter, _NOISE_M)  # m per axis, of the difference of two points
    longer = {k: float(np.hypot(template[k], 1.5 * noise)) for k in lengths}  # median length of a noisy difference
    ratio = {k: np.log(np.maximum(d, 1e-9) / longer[k]) for k, d in lengths.items()}
    middle = {k: float(np.median(v)) for k, v in ratio.items()}
    common = float(np.median(list(middle.values())))
    off = [abs(v - common) for v in middle.values()]
    sides = [
        abs(middle[a, b] - middle[twin])
        for a, b in middle
        if a.startswith("left_") and (twin := (a.replace("left", "right"), b.replace("left", "right"))) in middle
    ]
    change = [max(float(np.median(np.abs(v - middle[k]))) - noise / 1.48 / longer[k], 0.0) for k, v in ratio.items()]
    return float(np.mean(off) + np.mean(sides or [0.0]) + np.mean(change)) / 2


@cache
def _template(names: tuple[str, ...]) -> dict[tuple[str, str], float]:
    """Compute the length of the template's bone between each pair of key points that has one, m."""
    body = human()
    joint, offset, known = landmark_of(names, body)
    at = body.skeleton.rest_joints[joint] + offset
    column = {n: k for k, n in enumerate(names) if known[k]}
    return {
        (a, b): float(np.linalg.norm(at[column[a]] - at[column[b]])) for a, b in _PAIRS if a in column and b in column
    }


def wrong_way_up(points_world: Array, names: Sequence[str], pixels: Array, rig: CameraRig) -> Iterator[Finding]:
    """Test whether the world's up axis, the images' up direction and left and right are correct.

    points_world: (T, K, 3) m; NaN where missing.
    names: K names of the key points.
    pixels: (C, T, K, 3) px of the rig, and confidence.
    Returns: an iterator over findings.
    """
    top, feet = _middle(points_world, names, "shoulder"), _middle(points_world, names, "ankle")
    along = unit(top - feet)
    known = np.isfinite(along).all(1)
    if known.sum() < 3:
        return
    up, mean = along[known, 2], unit(along[known].mean(0))
    in_images = _upright_in_images(pixels, names)
    turned = (up < -_UPRIGHT).mean() > _WRONG_WAY_SHARE
    lying = (np.abs(up) < _UPRIGHT).mean() > _WRONG_WAY_SHARE
    if turned and in_images < -_UPRIGHT:
        yield Finding(
            "flipped",
            (),
            "All cameras: the key points stand on their heads in the images: their y seems to count from the bottom",
            "write y as the image's height minus y (or flip the videos back, if they are turned, too)",
        )
    elif turned:
        yield Finding(
            "up",
            (),
            "All cameras: the person stands on the head in the calibration's world, and upright in the images: the "
            "world's up is upside down",
            "give world_up in recording.toml the opposite sign",
        )
    elif lying and not in_images > _UPRIGHT:  # cameras mounted on their side show neither
        yield Finding(
            "lying",
            (),
            "All cameras: the person lies in the calibration's world from beginning to end",
            "if they stand, set world_up in recording.toml to the axis along which they do",
            severity=REVIEW,
        )
    elif lying and np.abs(mean).max() > 0.8 and float(cameras_up(rig) @ mean) > _UPRIGHT:
        axis = _axis(mean)
        yield Finding(
            "up",
            (),
            f"All cameras: the person stands along the world's {axis} axis, not along z",
            f"set world_up in recording.toml so that what is now {axis} points up",
        )
    if not turned and sides_exchanged(points_world, names):
        yield Finding(
            "sides",
            (),
            "All cameras: the person's left and right are exchanged (toes or nose point backwards): "
            "mirrored images, exchanged cameras, or the sides' names",
            "mirror the videos back, or check keypoint_set in recording.toml",
        )


def up_by_cameras(rig: CameraRig) -> Iterator[Finding]:
    """Test whether the upward directions of the cameras' images agree on an axis of the world other than z, and yield
    the finding.
    """
    mean = cameras_up(rig)
    agreed = float(np.linalg.norm(mean))
    if agreed > 0.75 and mean[2] / agreed < 0.3:
        axis = _axis(mean)
        yield Finding(
            "up",
            (),
            f"All cameras: the top of their images points along the world's {axis} axis, which should be z",
            f"set world_up in recording.toml so that what is now {axis} points up, unless the cameras hang that way",
        )


def _axis(direction: Array) -> str:
    """Name the axis of the world that is nearest to a direction (3,), such as "-x"."""
    k = int(np.argmax(np.abs(direction)))
    return ("-" if direction[k] < 0 else "") + "xyz"[k]


def cameras_up(rig: CameraRig) -> Array:
    """Compute the mean of the directions in the world that point upwards in the cameras' images.

    Returns: (3,) of length 1 at most: mean of unit vectors, in the world.
    """
    return np.mean([-c.camera_from_world[1, :3] for c in rig], axis=0)


def _upright_in_images(pixels: Array, names: Sequence[str]) -> float:
    """Compute the mean over views and frames of +1 (shoulders above ankles) and -1 (below); NaN without data."""
    at = {n: k for k, n in enumerate(names)}
    pairs = [(at.get(f"{side}_shoulder", -1), at.get(f"{side}_ankle", -1)) for side in ("left", "right")]
    ends = pixels[:, :, [pair for pair in pairs if min(pair) >= 0]]
    signs = np.sign(ends[..., 1, 1] - ends[..., 0, 1])[(ends[..., 2] > 0.3).all(-1)]
    return float(signs.mean()) if len(signs) else float("nan")


def _middle(points_world: Array, names: Sequence[str], part: str) -> Array:
    """Compute the middle (T, 3) between the left and right key point of a part."""
    column = {n: k for k, n in enumerate(names)}
    pair = [points_world[:, column[n]] for side in ("left", "right") if (n := f"{side}_{part}") in column]
    return np.mean(pair, axis=0) if len(pair) == 2 else np.full((len(points_world), 3), np.nan)


# ---- doctor report -------------------------------------------------------------------------------------------------
# The report of the diagnostics: findings with their evidence and next step, and the checks that need no geometry.


UNIT_ERRORS = (
    (1000.0, "metres are given as if they were millimetres, or the other way round"),
    (100.0, "centimetres and metres are mixed up"),
    (10.0, "centimetres and millimetres are mixed up"),
    (3.2808, "the lengths are feet"),
    (39.37, "the lengths are inches"),
)


@dataclass(frozen=True)
class ViewReport:
    """Report on one camera; px of the calibrated size, NaN where unknown.

    residual_px: median distance of its key points from the triangulation of all views.
    left_out_px: median distance of its key points from the triangulation of the other views.
    tangency_px: median disagreement of its silhouette's tangent planes with the other views.
    change: how far a refinement moves the camera.
    """

    name: str
    residual_px: float = float("nan")
    left_out_px: float = float("nan")
    tangency_px: float = float("nan")
    change: CameraChange | None = None


@dataclass(frozen=True)
class PersonReport:
    """Report of the diagnostics.

    findings: in the order of the checks.
    views: report on each camera, in the rig's order.
    """

    findings: tuple[Finding, ...]
    views: tuple[ViewReport, ...]

    @property
    def healthy(self) -> bool:
        """Whether there is no fault."""
        return not any(f.fault for f in self.findings)

    def of(self, view: str) -> tuple[Finding, ...]:
        """List the findings about one camera, and those about all cameras."""
        return tuple(f for f in self.findings if view in f.views or not f.views)


def clip_findings(rig: CameraRig, clips: Sequence[ViewFile], frame_rate: float) -> Iterator[Finding]:
    """Check the sizes, frame rates and numbers of frames of the views' files.

    clips: file of each view; none for no check.
    frame_rate: frames/s, where no file states it.
    Returns: an iterator over findings.
    """
    usual = float(np.median([c.frame_rate for c in clips if c.frame_rate] or [frame_rate]))
    most = int(np.median([c.frames for c in clips if c.frames] or [0]))
    for camera, clip in zip(rig, clips, strict=bool(clips)):
        if clip.size is not None and tuple(clip.size) != tuple(camera.size):
            yield _wrong_size(camera, clip.size, clip.accepted)
        off = abs((clip.frame_rate or usual) / usual - 1)
        if off > 0.005:
            yield Finding(
                "frame_rate",
                (camera.name,),
                f"{camera.name}: {clip.frame_rate:g} frames/s, the other views have {usual:g}",
                f"convert it to {usual:g} frames/s (ffmpeg -i IN -r {usual:g} OUT)",
                off,
            )
        if clip.frames and abs(clip.frames - most) > max(2, 0.01 * most):
            yield Finding(
                "frame_count",
                (camera.name,),
                f"{camera.name}: {clip.frames} frames, the other views have {most}",
                "copy the video again if it was cut off; else check with hypose sync that all started together",
                float(abs(clip.frames - most)),
            )


def _wrong_size(camera: Camera, size: tuple[int, int], accepted: bool) -> Finding:
    """Make the finding that images have another size, px, than the camera is calibrated for.

    accepted: the user has stated that the images were only stretched.
    """
    (w, h), (cw, ch) = size, camera.size
    fx, fy, severity = w / cw, h / ch, INVALID
    by, off = f"{fx:.4f} x {fy:.4f}", abs(fx / fy - 1)
    if abs(h / cw - 1) < 0.01 and abs(w / ch - 1) < 0.01:
        how, cure, off = " (turned by 90 degrees)", "turn the video back", 1.0
    elif accepted:
        how, cure, severity = f": stretched by {by}, as accepted", "nothing", REVIEW
    elif off < 0.002:
        how, off, severity = f": scaled to {100 * fx:.0f} %", abs(fx - 1), REVIEW
        cure = 'nothing if the video was only scaled; key points detected in it need keypoint_pixels = "image"'
    else:
        how, cure = (
            f": scaled by {by}, or cut by {cw - w} x {ch - h} px",
            "if it was stretched, set accept_scaled = true for the view; if it was cut, correct the principal point "
            "and the size in the calibration",
        )
    text = f"{camera.name}: its images are {w} x {h} px, it is calibrated for {cw} x {ch} px{how}"
    return Finding("size", (camera.name,), text, cure, off, severity)


def person_findings(
    rig: CameraRig, pixels: Array, names: Sequence[str], height: float | None, o: Limits
) -> Iterator[Finding]:
    """Check the person: key-point set, up, left and right, and size, which shows wrong units and a wrong scale.

    pixels: (C, T, K, 3) distorted px, and confidence.
    names: K names of the key points.
    height: known height, m.
    o: limits.
    Returns: an iterator over findings.
    """
    if len(rig) < 2:
        return
    world = triangulated(rig, pixels)
    other = wrong_set(world, names)
    if other is not None:
        yield other
        return
    yield from wrong_way_up(world, names, pixels, rig)
    try:
        shape = shape_from_keypoints(human(), world, tuple(names))
    except (EvidenceError, ValueError):
        return
    found = float(shape.scale) * human().stature
    if np.isfinite(found):
        yield from height_findings(found, height, o)


def height_findings(found: float, height: float | None, o: Limits) -> Iterator[Finding]:
    """Check the unit and scale of the calibration with the person's height.

    found: measured height, m.
    height: known height, m.
    o: limits.
    Returns: an iterator over findings.
    """
    off = abs(float(np.log(found / (height or 1.7))))
    share, severity = abs(found / height - 1) if height is not None else 0.0, REVIEW
    if not o.heights[0] <= found <= o.heights[1]:
        likely = (words for factor, words in UNIT_ERRORS if any(1.3 <= found * f <= 2.1 for f in (factor, 1 / factor)))
        text = f"would be {found:.3g} m tall: {next(likely, 'the scale of the calibration is wrong')}"
        cure = "set calibration_unit in recording.toml, or correct the translations and the board's square size"
        severity = INVALID
    elif share > o.height_share:
        text = f"would be {found:.2f} m tall, {height:.2f} m is known"
        cure = "check the board's square size; hypose check --refine keeps the known height"
        severity = INVALID
    elif share > o.height_doubt:
        text = f"comes out {found:.2f} m tall, {height:.2f} m is known: joints are off by that share of their distances"
        cure = "check the board's square size and the focal lengths"
    elif height is None and not o.usual_heights[0] <= found <= o.usual_heights[1]:
        text = f"comes out {found:.2f} m tall, as the calibration's unit and focal lengths have it"
        cure = "give the person's height if it is right (--height), else check the board's square size"
    else:
        return
    yield Finding("unit", (), f"All cameras: the person {text}", cure, off, severity=severity)
