"""What OpenSim's inverse kinematics needs beside the model: markers of the tracked body and a set-up with weights.

The markers are those of the model (`opensim_model.marker_names`): joint centres and the body's landmarks, in the frames
of the motion. A marker's weight is the inverse of its joint's variance over the clip, and in single frames it is
missing where its joint is more likely wrong than right; OpenSim's tool knows no weights that change by the frame.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.geometry import Array
from hypose.io.files import write_text
from hypose.io.motions.opensim_model import marker_names, numbers, put
from hypose.io.motions.trc import write_trc

_USUAL_SD = 0.02  # m: the weight of a marker with it is 1
_WEIGHTS = (0.05, 20.0)


def write_ik_markers(path: str | Path, motion: Motion, body: Body) -> None:
    """Write the model's markers in every frame as TRC (m). The motion needs poses (T, D)."""
    assert motion.poses is not None
    points = np.concatenate([motion.joints, body.landmark_points(motion.poses)], axis=1)
    if motion.p_wrong is not None:
        wrong = np.nan_to_num(motion.p_wrong) > 0.5
        wrong[motion.lost.astype(bool)] = False  # nothing is known of the frame: OpenSim goes through the prediction
        points[wrong[:, _carriers(motion, body)]] = np.nan
    write_trc(path, marker_names(body), points, motion.frame_rate, start_time=float(motion.times[0]))


def write_ik_setup(path: str | Path, motion: Motion, body: Body, model: str, markers: str, output: str) -> None:
    """Write the set-up of OpenSim's Inverse Kinematics tool: file names as they stand beside it."""
    root = Xml.Element("OpenSimDocument", Version="40000")
    tool = put(root, "InverseKinematicsTool", name=Path(output).stem)
    put(tool, "model_file", model)
    put(tool, "constraint_weight", "Inf")
    put(tool, "accuracy", "1e-05")
    tasks = put(put(tool, "IKTaskSet"), "objects")
    for name, weight in zip(marker_names(body), marker_weights(motion, body).tolist(), strict=True):
        task = put(tasks, "IKMarkerTask", name=name)
        put(task, "apply", "true")
        put(task, "weight", f"{weight:.4g}")
    put(tool, "marker_file", markers)
    put(tool, "time_range", numbers([motion.times[0], motion.times[-1]]))
    put(tool, "report_errors", "true")
    put(tool, "output_motion_file", output)
    Xml.indent(root, "\t")
    write_text(path, '<?xml version="1.0" encoding="UTF-8" ?>\n' + Xml.tostring(root, encoding="unicode") + "\n")


def marker_weights(motion: Motion, body: Body) -> Array:
    """(M,) one weight per marker of the model, 1 for a standard deviation of 2 cm of its joint."""
    sd = np.where(motion.joint_sd > 0, motion.joint_sd, np.nan)
    usual = np.array([np.nanmedian(s) if np.isfinite(s).any() else _USUAL_SD for s in sd.T])
    return np.clip((_USUAL_SD / usual) ** 2, *_WEIGHTS)[_carriers(motion, body)]


def _carriers(motion: Motion, body: Body) -> list[int]:
    """The joint that carries each marker."""
    return [*range(len(motion.skeleton.joint_names)), *body.landmarks.joint.tolist()]
