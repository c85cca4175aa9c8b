"""What the closing lines of a command, the report and the studio share: figures of a motion, and what files are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import EvidenceError

DESCRIPTIONS = {
    "motion.npz": "poses, joints, uncertainty and flags (numpy; metres, radians, seconds; world z up)",
    "body.npz": "the subject's body",
    "modes.npz": "one camera: all hypotheses of every frame with weights and covariances (hypose.io.motions.results)",
    "motion.trc": "joint centres for OpenSim (millimetres, y up)",
    "motion.c3d": "joint centres as float C3D (millimetres, z up; residual = standard deviation)",
    "motion.mot": "joint angles for OpenSim (degrees, metres)",
    "motion_sd.sto": "standard deviations of those angles (degrees, metres)",
    "motion.osim": "OpenSim model of this person, on which motion.mot plays (metres, kilograms)",
    "motion_markers.trc": "markers of that model (metres, y up)",
    "motion_ik.xml": "set-up of OpenSim's inverse kinematics with weights from the standard deviations",
    "motion.bvh": "skeleton animation (metres, degrees, y up)",
    "motion.glb": "skinned, animated body for Blender and browsers (metres, y up)",
    "angles.csv": "joint angles (degrees)",
    "joints.csv": "joint centres with their standard deviation (metres, z up) and flags per frame",
    "overlay.mp4": "the body on the recorded images",
    "provenance.json": "settings, versions, inputs with their hashes",
    "verdict.json": "good, look at frames, or not to be trusted, and why; the frames in which each joint is doubtful",
    "report.html": "this report",
}
"""What each file of a results folder is."""


@dataclass(frozen=True)
class Summary:
    """iou: mean overlap (NaN when not known); worst_iou; sd_mm: median over joints and frames."""

    frames: int
    seconds: float
    lost: int
    extrapolated: int
    iou: float
    worst_iou: float
    sd_mm: float


def summarize(motion: Motion) -> Summary:
    """The figures of a motion."""
    iou, sd = 1 - motion.cost, motion.joint_sd
    iou, sd = iou[np.isfinite(iou)], sd[np.isfinite(sd)]
    return Summary(
        len(motion),
        len(motion) / motion.frame_rate,
        int(motion.lost.sum()),
        int((motion.extrapolated & ~motion.lost).sum()),
        float(iou.mean()) if len(iou) else float("nan"),
        float(iou.min()) if len(iou) else float("nan"),
        float(np.median(sd)) * 1000 if len(sd) else float("nan"),
    )


def require_found(motion: Motion, name: str, kept: Path) -> None:
    """An EvidenceError when the person was found in no frame of a motion, whose files lie in `kept`."""
    if not (motion.lost | motion.extrapolated).all():
        return
    raise EvidenceError(
        f"{name}: the person was found in none of {len(motion)} frames; {kept} keeps what was guessed, every frame "
        "marked. Look at the evidence (`hypose check` for cameras), and begin with frames that show the person."
    )


def subject_rows(body: Body) -> list[tuple[str, float]]:
    """Sizes of a body by name, metres between joint centres; limbs: mean of both sides."""
    rows = [("stature", body.stature)]
    lengths: dict[str, float] = body.segment_lengths()
    for name, value in lengths.items():
        if name.startswith("left_"):
            plain = name.removeprefix("left_")
            rows.append((plain, 0.5 * (value + lengths[f"right_{plain}"])))
        elif not name.startswith("right_"):
            rows.append((name, value))
    return [(n.replace("_", " "), v) for n, v in rows]
