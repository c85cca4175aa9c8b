"""Pack one result for the View screen into one block of bytes, which the server sends and the report contains.

Layout: the eight bytes "HYPOSEV1", length of the header (uint32), header (JSON, UTF-8), zeros up to a multiple of 8,
    then the arrays, each at a multiple of 8 bytes from there; all little-endian. The header's "arrays" gives dtype (f4,
    f8, u1, u2, u4), shape and offset of each, so that a browser reads them without a copy. Metres, seconds, radians
    (angles: degrees), world z up.
"""

from __future__ import annotations

import contextlib
import json
import struct
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hypose import __version__
from hypose.app.reports.report_parts import DESCRIPTIONS, subject_rows, summarize
from hypose.app.studio.catalog import recording_above
from hypose.body.body import Body, Mesh
from hypose.body.joint_angles import ANGLE_NAMES, TURNS, angles_in_time, is_length, turns_reader
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.errors import HyposeError, InputError
from hypose.geometry import Array, quaternion_from_matrix
from hypose.io.motions.export import MOTION_FORMATS
from hypose.io.motions.results import json_values, load_body, load_joints_of_modes, load_motion
from hypose.io.recordings.recording import Recording, load_recording
from hypose.pipeline.assessment import Assessment, assess, load_assessment
from hypose.pipeline.comparison import Truth, compare_with_truth
from hypose.pipeline.gait import angle_cycles, gait_of
from hypose.tracking.recipes import citation_of

MAGIC = b"HYPOSEV1"
_LOST, _EXTRAPOLATED, _LOW_CONFIDENCE = 1, 2, 3
MOST_RIVALS = 6
_UNKNOWN_PERCENT = 255
_ANKLE_M = 0.08
"""Usual height of the ankle above the sole, m."""
_AT_ONCE = 1 << 11
"""Frames that are converted at a time."""
_THREADS = 2
"""Threads that convert frames."""
_NEEDED = {"pelvis", "chest", "head", "left_shoulder", "left_elbow", "left_hip", "left_knee", "left_ankle"}
"""Joints for which anatomical angles are defined."""


@dataclass(frozen=True)
class Rivals:
    """Other poses that the evidence of a motion's frames allows.

    rows: (N,) rows of the motion that have another pose.
    joints: (N, R, J, 3) m, joints of the R other poses, best first; NaN where a frame has fewer.
    weights: (T, 1 + R) probabilities; column 0 is that of the motion's own pose.
    """

    rows: NDArray[np.int64]
    joints: NDArray[np.float32]
    weights: NDArray[np.float32]

    @classmethod
    def of(cls, joints: Array, weights: Array) -> Rivals | None:
        """Make the rivals from all modes of a clip.

        joints, weights: (T, K, J, 3) m and (T, K); the first mode of each frame is the motion's own pose.

        Returns: at most MOST_RIVALS other poses; None where there are none.
        """
        if joints.shape[1] < 2:
            return None
        others = joints[:, 1 : 1 + MOST_RIVALS]
        rows = np.flatnonzero(np.isfinite(others).any((1, 2, 3)))
        return cls(rows, others[rows].astype(np.float32), weights[:, : 1 + MOST_RIVALS].astype(np.float32))

    @classmethod
    def of_motion(cls, motion: Motion) -> Rivals | None:
        """Make the rivals from the other poses that a motion keeps; None where it keeps none."""
        if motion.rivals is None or motion.rival_weights is None or not motion.rival_weights.any():
            return None
        others = motion.rival_weights.astype(np.float64)
        there = others > 0
        rows = np.flatnonzero(there.any(1))
        joints = np.full((len(rows), there.shape[1], len(motion.skeleton.joint_names), 3), np.nan, np.float32)
        joints[there[rows]] = motion.skeleton.forward(motion.rivals[there])[1]
        weights = np.concatenate([1 - others.sum(1, keepdims=True), np.where(others > 0, others, np.nan)], 1)
        return cls(rows, joints, weights.astype(np.float32))


@dataclass(frozen=True)
class ViewResult:
    """Result to show.

    title: title of the page.
    motion: the motion.
    body: None where not known, e.g. for a fused skeleton.
    recording: recording of the motion, with its cameras; None where not known.
    first_frame: frame of the recording in row 0.
    files: (name, meaning, bytes).
    notes: sentences for the user.
    citation: source of the method.
    seconds: time per stage, s.
    truth: comparison with the true motion of a synthetic recording.
    complete: every frame was tracked.
    rivals: other poses, where the method keeps any.
    assessment: assessment of the result; None where there is none.
    """

    title: str
    motion: Motion
    body: Body | None = None
    recording: Recording | None = None
    first_frame: int = 0
    files: Sequence[tuple[str, str, int]] = ()
    notes: Sequence[str] = ()
    citation: str = ""
    seconds: Mapping[str, float] = field(default_factory=dict)
    truth: Truth | None = None
    complete: bool = True
    rivals: Rivals | None = None
    assessment: Assessment | None = None


def view_bundle(result: ViewResult) -> bytearray:
    """Pack a result into the block of bytes."""
    arrays = _arrays(result)
    header = _header(result)
    offset, index = 0, {}
    for name, a in arrays.items():
        index[name] = {"dtype": a.dtype.str[1:], "shape": list(a.shape), "offset": offset}
        offset += -(-a.nbytes // 8) * 8
    header["arrays"] = index
    text = json.dumps(json_values(header), ensure_ascii=False, separators=(",", ":")).encode()
    start = -(-(len(MAGIC) + 4 + len(text)) // 8) * 8
    block = bytearray(start + offset)
    struct.pack_into(f"<{len(MAGIC)}sI{len(text)}s", block, 0, MAGIC, len(text), text)
    for name in list(
        arrays
    ):  # each array is released as soon as it is copied, so that memory holds one long motion only
        a = np.ascontiguousarray(arrays.pop(name)).reshape(-1).view(np.uint8)
        at = start + index[name]["offset"]
        block[at : at + len(a)] = a.data
    return block


def _arrays(result: ViewResult) -> dict[str, np.ndarray]:
    """Make the arrays of the block by their names; they are listed in web/src/lib/bundle.ts."""
    m = result.motion
    # first the arrays whose computation needs most memory
    turns = {} if m.poses is None else _turns(m.skeleton, m.poses)
    low = np.zeros(len(m), dtype=bool) if m.low_confidence is None else m.low_confidence
    cases = [m.lost.astype(bool), m.extrapolated.astype(bool), low]  # of several the first counts
    out = turns | {
        "times": m.times.astype("<f8"),
        "joints": m.joints.astype("<f4"),
        "joint_covariance": m.joint_covariance[..., *np.triu_indices(3)].astype("<f4", copy=False),
        "flags": np.select(cases, [_LOST, _EXTRAPOLATED, _LOW_CONFIDENCE], 0).astype("u1"),
        "n_views": np.clip(m.n_views, 0, 255).astype("u1"),
        "cost": m.cost.astype("<f4"),
    }
    if m.poses is not None:
        if "angles" in out and m.angle_sd is not None:
            out["angle_sd"] = _in_degrees(m.angle_sd.T)
        if result.body is not None:
            out |= _mesh("fine", result.body.fine) | _mesh("coarse", result.body.coarse)
            out["rest_joints"] = m.skeleton.rest_joints.astype("<f4")
    if m.low_confidence_joints is not None:
        out["low_confidence_joints"] = m.low_confidence_joints.astype("u1")
    if m.error_probability is not None:
        percent = np.rint(100 * np.nan_to_num(m.error_probability, nan=_UNKNOWN_PERCENT / 100))
        out["error_probability"] = percent.astype("u1")
    if result.rivals is not None:
        out["rival_rows"] = result.rivals.rows.astype("<u4")
        out["rival_joints"] = result.rivals.joints.astype("<f4")
        out["rival_weights"] = result.rivals.weights.astype("<f4")
    if result.truth is not None:
        out["truth_joints"] = result.truth.joints.astype("<f4")
        out["truth_distances"] = result.truth.distances.astype("<f4")
    return out


def _turns(skeleton: Skeleton, poses: Array) -> dict[str, np.ndarray]:
    """Compute the rotations of joints in poses (T, D), and anatomical angles where the skeleton has them. Some frames
    at a time, since intermediate arrays are several times as large as a long motion.
    """
    known = np.flatnonzero(np.isfinite(poses).all(1))
    rotations = np.full((len(poses), len(skeleton.joint_names), 4), np.nan, "<f4")
    read = turns_reader(skeleton) if _NEEDED <= set(skeleton.joint_names) else None
    turns = np.empty((TURNS if read else 0, len(known)))

    def fill(at: int) -> None:
        rows = known[at : at + _AT_ONCE]
        frames, centres = skeleton.forward(poses[rows])
        rotations[rows] = quaternion_from_matrix(frames)[..., [1, 2, 3, 0]]
        if read:
            turns[:, at : at + _AT_ONCE] = read(frames, centres)

    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(fill, range(0, len(known), _AT_ONCE)))
    if not read:
        return {"rotations": rotations}
    angles = np.full((len(ANGLE_NAMES), len(poses)), np.nan, "<f4")
    if len(known):
        angles[:, known] = _in_degrees(angles_in_time(turns))
    return {"rotations": rotations, "angles": angles}


def _in_degrees(values: Array | NDArray[np.float32]) -> np.ndarray:
    """Convert angles (A, T), in the order of ANGLE_NAMES, from rad to degrees, float32; lengths stay in metres."""
    lengths = np.array([is_length(name) for name in ANGLE_NAMES])
    return np.where(lengths[:, None], values, np.degrees(values)).astype("<f4")


def _mesh(level: str, mesh: Mesh) -> dict[str, np.ndarray]:
    """Make the arrays of a mesh; level ("fine", "coarse") is the first part of their names."""
    index = "<u2" if len(mesh.vertices) < 2**16 else "<u4"
    return {
        f"{level}_vertices": mesh.vertices.astype("<f4"),
        f"{level}_faces": mesh.faces.astype(index),
        f"{level}_skin_index": mesh.skin_index.astype("u1"),
        f"{level}_skin_weight": mesh.skin_weight.astype("<f4"),
    }


def _header(result: ViewResult) -> dict[str, Any]:
    m, s, truth, recording = result.motion, result.motion.skeleton, result.truth, result.recording
    seen = () if recording is None else zip(recording.views, recording.rig, strict=True)
    return {
        "version": __version__,
        "title": result.title,
        "recipe": str(m.provenance.get("recipe", "unknown")),
        "frames": len(m),
        "frame_rate": m.frame_rate,
        "first_frame": result.first_frame,
        "complete": result.complete,
        "summary": asdict(summarize(m)),
        "joint_names": list(s.joint_names),
        "parents": s.parents,
        "floor": _floor(m),
        "formats": list(MOTION_FORMATS) if m.poses is not None else ["trc", "c3d", "csv"],
        "angles": [{"name": n, "unit": "m" if is_length(n) else "°"} for n in ANGLE_NAMES],
        "cameras": [
            {
                "name": c.name,
                "K": c.K,
                "distortion": c.distortion,
                "fisheye": c.fisheye,
                "camera_from_world": c.camera_from_world,
                "size": list(c.size),
                "image_shift": list(v.image_shift),
                "pictures": v.has_pictures,
            }
            for v, c in seen
        ],
        "subject": subject_rows(result.body) if result.body is not None else [],
        "files": [{"name": n, "what": w, "bytes": b} for n, w, b in result.files],
        "notes": list(result.notes),
        "citation": result.citation,
        "seconds": dict(result.seconds),
        "assessment": result.assessment and {"word": result.assessment.word, "sentence": result.assessment.sentence},
        "truth": truth
        and {
            "names": list(truth.names),
            "parents": s.parents,
            "mean_mm": truth.mean_mm,
            "note": truth.note,
        },
        "provenance": dict(m.provenance),
    }


def _floor(motion: Motion) -> float:
    """Estimate the height of the floor, m, world: 0, unless the feet are clearly elsewhere.

    motion: its feet are at their lowest twentieth on the floor.
    """
    feet = [j for j, n in enumerate(motion.skeleton.joint_names) if n.endswith(("ankle", "foot"))]
    low = motion.joints[:, feet, 2]
    low = low[np.isfinite(low)]
    standing = float(np.percentile(low, 5)) - _ANKLE_M if len(low) else 0.0
    return 0.0 if abs(standing) < 0.25 else standing


# ---- view result ---------------------------------------------------------------------------------------------------
# Load a results folder to be shown: the motion with body, recording and truth.


_T = TypeVar("_T")


def load_view(results: str | Path, recording: Recording | None = None) -> ViewResult:
    """Load a results folder, or a motion.npz, to be shown.

    recording: default: the one whose folder contains the results. A body, recording or truth that is missing or
        unreadable is left out with a note.
    Raises: InputError where there is no motion.
    """
    path = Path(results)
    if not path.exists():
        raise InputError(f"{path} does not exist; give the results folder that hypose track wrote.")
    folder = path if path.is_dir() else path.parent
    motion = load_motion(folder / "motion.npz" if path.is_dir() else path)
    if len(motion) == 0:
        raise InputError(f"{path} holds a motion of no frames, so there is nothing to show; track the recording again.")
    notes: list[str] = []

    def part(what: str, make: Callable[[], _T | None]) -> _T | None:
        try:
            return make()
        except HyposeError as error:
            notes.append(f"{what}: {error}")
            return None

    body = part("The body is not shown", lambda: body_of_result(folder, motion))
    if recording is None:
        recording = part("The recording cannot be shown", lambda: find_recording(folder))
    first, truth, how = first_frame(motion), None, motion.provenance.get("settings")
    if recording is not None:
        notes += recording.notes
        known = recording.folder / "truth.npz"
        if known.is_file() and motion.poses is not None:
            truth = part("The truth is not shown", lambda: compare_with_truth(known, motion, first))
    return ViewResult(
        recording.name if recording is not None else folder.resolve().name,
        motion,
        body,
        recording,
        first_frame=first,
        files=[(n, w, p.stat().st_size) for n, w in DESCRIPTIONS.items() if (p := folder / n).is_file()],
        notes=notes,
        citation=citation_of(
            str(motion.provenance.get("recipe")), isinstance(how, Mapping) and bool(how.get("refine"))
        ),
        truth=truth,
        complete=not (folder / "checkpoint.npz").exists(),
        rivals=part("Other poses are not shown", lambda: _rivals(folder / "modes.npz", motion)),
        assessment=_assessment(folder, motion),
    )


def first_frame(motion: Motion) -> int:
    """Return the number of the recording's frame that is row 0 of a motion, from the motion's provenance; 0 where it
    is not known.
    """
    with contextlib.suppress(TypeError, KeyError, IndexError, ValueError, OverflowError):
        return int(motion.provenance["settings"]["frames"][0])
    return 0


def find_recording(results: Path) -> Recording | None:
    """Load the recording whose folder contains the results (results/RECIPE/ in it); None where there is none."""
    folder = recording_above(results)
    return None if folder is None else load_recording(folder)


def body_of_result(folder: Path, motion: Motion) -> Body | None:
    """Load the body of a result.

    folder: folder of the result.
    motion: motion of the result.
    Returns: None where the motion has no poses, or no body was kept.
    Raises: InputError where body and motion do not belong together.
    """
    path = folder / "body.npz"
    if motion.poses is None or not path.is_file():
        return None
    body = load_body(path)
    if body.skeleton.joint_names != motion.skeleton.joint_names:
        raise InputError("body.npz and the motion belong to different bodies; track again.")
    return body


def gait_values(motion: Motion, body: Body | None) -> dict[str, Any]:
    """Compute the gait of a motion for the View screen and the report.

    Returns: table of lists: "events" (time in s, side, kind), "figures" (name, unit, mean, low, high, number), and
        "cycles" (of each joint angle the mean and standard deviation in degrees, from 0 to 100 % of the cycle). All are
        empty where the person does not walk, or the motion has no poses or no body.
    """
    if motion.poses is None or body is None:
        return {"events": [], "figures": [], "cycles": []}
    found = gait_of(motion, body)
    return {
        "events": [{"time": e.time, "side": e.side, "kind": e.kind} for e in found.events],
        "figures": [asdict(f) for f in found.figures],
        "cycles": [
            {"name": c.name, "mean": np.degrees(c.mean), "sd": np.degrees(c.sd), "n": c.n}
            for c in angle_cycles(found.events, motion)
        ],
    }


def _rivals(path: Path, motion: Motion) -> Rivals | None:
    """Load the other poses: from the modes of a track with one camera, whose first mode is the motion; else from the
    motion.
    """
    if not path.is_file():
        return Rivals.of_motion(motion)
    joints, weights = load_joints_of_modes(path)
    return Rivals.of(joints, weights) if (len(joints), joints.shape[2]) == motion.joints.shape[:2] else None


def _assessment(folder: Path, motion: Motion) -> Assessment | None:
    """Load the assessment that was written after tracking; where it is missing, assess the motion."""
    return load_assessment(folder) or (None if motion.low_confidence is None else assess(motion))


def quality_of(folder: Path, motion: Motion) -> dict[str, Any]:
    """Summarize the quality of a result for a list.

    folder: folder of the result.
    motion: motion of the result.
    Returns: assessment (word or None) and its sentence, iou (0..1), sd_mm, lost (share of frames).
    """
    reported, s = _assessment(folder, motion), summarize(motion)
    lost = (s.lost + s.extrapolated) / max(1, s.frames)
    word, sentence = (reported.word, reported.sentence) if reported else (None, None)
    return {"assessment": word, "sentence": sentence, "iou": s.iou, "sd_mm": s.sd_mm, "lost": lost}
