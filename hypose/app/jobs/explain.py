"""Explain in words where a joint of a result comes from: its evidence, the passes that moved it, other poses."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hypose.app.studio.view_bundle import find_recording, first_frame
from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import HyposeError, InputError
from hypose.io.motions.results import load_result_body
from hypose.io.recordings.frames import FrameSettings, FrameStream
from hypose.pipeline.assessment import trace_of
from hypose.pipeline.settings import SETTINGS
from hypose.tracking.frame_evidence import keypoint_model


def explain_joint(results: Path, joint: str, frame: int) -> list[str]:
    """Explain the position of one joint in one frame.

    results: folder of a result, or its motion.npz.
    joint: name of the joint.
    frame: number in the recording.
    Returns: lines of text.
    Raises: InputError where the result has no such joint or frame.
    """
    motion, body = load_result_body(results)
    names, first = motion.skeleton.joint_names, first_frame(motion)
    if joint not in names:
        raise InputError(f"{results} has no joint {joint!r}; its joints are {', '.join(names)}.")
    if not first <= frame < first + len(motion):
        raise InputError(f"{results} has the frames {first} to {first + len(motion) - 1}; frame {frame} is not there.")
    row, j = frame - first, names.index(joint)
    return [
        *_position(motion, row, j, f"{joint} in frame {frame} ({motion.times[row]:.2f} s)"),
        *_evidence(motion, body, results if results.is_dir() else results.parent, row, frame, joint),
        *_moved(motion, row, first, joint),
        *_rivals(motion, row, j),
    ]


def _position(motion: Motion, row: int, j: int, what: str) -> list[str]:
    """Return sentences on where the joint is, and how certain that is.

    row: row of the motion.
    j: number of the joint.
    what: first words of the sentence.
    """
    x, y, z = motion.joints[row, j]
    said = f"{what}: at ({x:.3f}, {y:.3f}, {z:.3f}) m"
    if np.isfinite(sd := motion.joint_sd[row, j]):
        said += f", sd {1e3 * sd:.0f} mm per axis"
    if motion.error_probability is not None and np.isfinite(p := motion.error_probability[row, j]):
        said += f", P(error > 100 mm) = {p:.2f}"
    if motion.low_confidence_joints is not None and motion.low_confidence_joints[row, j]:
        said += ", low confidence"
    if motion.lost[row]:
        return [said, "The person was not found in this frame."]
    return [said, *(["No evidence in this frame: the pose is predicted."] if motion.extrapolated[row] else [])]


def _evidence(motion: Motion, body: Body, folder: Path, row: int, frame: int, joint: str) -> list[str]:
    """Return sentences on the evidence of the frame, and how far the joint is from its key point in each view.

    folder: folder of the result, in its recording; without the recording only the kind of evidence is given.
    row: row of the motion.
    frame: number in the recording.
    """
    settings = motion.provenance.get("settings", {})
    kind = settings.get("evidence", "unknown") if isinstance(settings, Mapping) else "unknown"
    said = f"Evidence: {kind}, {motion.n_views[row]} views"
    if np.isfinite(cost := motion.cost[row]):
        said += f"; the body overlaps the masks by {1 - cost:.2f} (IoU; .85 and more is usual for a good fit)"
    lines = [said]
    with contextlib.suppress(HyposeError):  # without the recording there is less to say
        if (recording := find_recording(folder)) is not None and motion.poses is not None:
            with FrameStream(recording, FrameSettings(masks=False)) as stream:
                points = stream.frame(frame - recording.frames.start).keypoints
            if points is not None and joint in points.names:
                k = points.names.index(joint)
                at = keypoint_model(body, points.names).positions(body, motion.poses[row])[k]
                for name, camera, (u, v, confidence) in zip(
                    points.rig.names, points.rig, points.points[:, k, :3], strict=True
                ):
                    off = np.linalg.norm(camera.project(at[None])[0] - (u, v))
                    seen = f"{off:.0f} px away (confidence {confidence:.2f})" if confidence > 0 else "not detected"
                    lines.append(f"  {name}: its key point is {seen}")
    return lines


def _moved(motion: Motion, row: int, first: int, joint: str) -> list[str]:
    """Return sentences on which passes moved the joint.

    row: row of the motion.
    first: number of the frame in row 0.
    """
    if "trace" not in motion.provenance:
        return ["Which passes moved it was not recorded; track again."]
    found = [c for c in trace_of(motion) if c.joint == joint and row in c.frames]
    if not found:
        return [f"No pass moved it by more than {1e3 * SETTINGS.trace_least_m:.0f} mm after its frame was solved."]
    return [
        "Moved, in this order, by:",
        *(
            f"  {c.stage}: up to {1e3 * c.moved:.0f} mm in frames {first + c.frames.start} to "
            f"{first + c.frames.stop - 1}: {c.reason}"
            for c in found
        ),
    ]


def _rivals(motion: Motion, row: int, j: int) -> list[str]:
    """Return sentences on where else the joint may be; empty where the method keeps no other poses.

    row: row of the motion.
    j: number of the joint.
    """
    if motion.rivals is None or motion.rival_weights is None:
        return []
    shares = motion.rival_weights[row]
    at = motion.skeleton.forward(motion.rivals[row].astype(np.float64))[1][:, j]
    off = np.linalg.norm(at - motion.joints[row, j], axis=-1)
    said = [f"{1e3 * d:.0f} mm away with {100 * w:.0f} %" for d, w in zip(off, shares, strict=True) if w > 0.005]
    return [f"Other poses that the evidence allows have it {', '.join(said)}." if said else "No other pose is likely."]
