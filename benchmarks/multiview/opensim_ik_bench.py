"""What OpenSim makes of a result: its inverse kinematics with the model, markers and weights that were exported."""

from __future__ import annotations

import contextlib
import importlib
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.multiview.real_recordings import balancing_recording, in_memory
from hypose.errors import InputError
from hypose.geometry import Array
from hypose.io.motions.export import export_motion
from hypose.io.motions.marker_files import read_mot, read_trc
from hypose.pipeline.run import track_source
from hypose.pipeline.subject import SubjectOptions, find_subject
from hypose.pipeline.track_options import TrackOptions


def opensim(options: BenchOptions) -> BenchReport:
    """Balancing, tracked from key points: distances of the model's markers from the exported ones after OpenSim's own
    inverse kinematics, columns of motion.mot that the model lacks, and how far the angles of both are apart."""
    program = _opensim()
    recording = balancing_recording(options.folder("pose2sim_balancing"))
    rate, n = recording.frame_rate, 20 if options.quick else len(recording.frames)
    source = in_memory(recording, n)
    options.progress("track", 0, 2)
    subject = find_subject(source.frame, n, SubjectOptions("keypoints", frame_rate=rate))
    motion = track_source(source, rate, TrackOptions(evidence="keypoints"), subject=subject).motion
    options.progress("inverse kinematics", 1, 2)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        export_motion(motion, subject.body, folder, ("mot", "osim"))
        with contextlib.chdir(folder):  # the tool looks for files where it is started
            program.InverseKinematicsTool("motion_ik.xml").run()
        distance, missing = _against(program, folder)
        ours, theirs = read_mot(folder / "motion.mot"), read_mot(folder / "motion_ik.mot")
    shared = [k for k in ours[1] if k in theirs[1] and k.startswith(("hip_flexion", "knee_angle", "elbow_flex"))]
    apart = [np.abs(ours[2][:, ours[1].index(k)] - theirs[2][:, theirs[1].index(k)]) for k in shared]
    rows = (
        Row("marker_rmse_mm", "balancing", 1e3 * float(np.sqrt(np.nanmean(distance**2))), "mm", n=distance.size),
        Row("marker_max_mm", "balancing", 1e3 * float(np.nanmax(distance)), "mm", n=distance.size),
        Row("columns_missing", "balancing", float(missing), "1", n=len(ours[1])),
        Row("angle_difference_deg", "balancing", float(np.degrees(np.mean(apart))), "deg", n=len(shared)),
    )
    return BenchReport(rows, {"frames": n, "evidence": "keypoints", "opensim": program.GetVersion()})


def _opensim() -> Any:
    try:
        program = importlib.import_module("opensim")
    except ImportError:
        raise InputError("This benchmark runs OpenSim's own tools; pip install opensim.") from None
    program.Logger.setLevelString("Error")
    return program


def _against(program: Any, folder: Path) -> tuple[Array, int]:
    """(T, M) m: the model's markers under OpenSim's solution from the exported ones; columns that the model lacks."""
    model = program.Model(str(folder / "motion.osim"))
    state = model.initSystem()
    coordinates = model.getCoordinateSet()
    header = (folder / "motion.mot").read_text().split("endheader\n")[1].splitlines()[0].split("\t")[1:]
    missing = sum(not coordinates.contains(name) for name in header)
    table = program.TimeSeriesTable(str(folder / "motion_ik.mot"))
    degrees = table.getTableMetaDataString("inDegrees") == "yes"
    labels, values = list(table.getColumnLabels()), table.getMatrix().to_numpy()
    given = read_trc(folder / "motion_markers.trc")
    out = np.full(given.points.shape[:2], np.nan)
    for t, row in enumerate(values):
        for label, value in zip(labels, row.tolist(), strict=True):
            coordinate = coordinates.get(label)
            if coordinate.get_locked():
                continue
            turn = degrees and not label.endswith(("_tx", "_ty", "_tz"))
            coordinate.setValue(state, np.radians(value) if turn else value, False)
        model.realizePosition(state)
        for m, name in enumerate(given.names):
            p = model.getMarkerSet().get(name).getLocationInGround(state)
            world = np.array([p.get(2), p.get(0), p.get(1)])  # ground (x, y, z) is world (y, z, x)
            out[t, m] = np.linalg.norm(world - given.points[t, m])
    return out, missing
