"""Recordings of skeletons written as the folders that `hypose fuse` reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hypose.evidence.frame import SensorReport
from hypose.io.sensors.skeleton_files import FolderWriter, SkeletonRecording, empty_report


def write_folder(recording: SkeletonRecording, folder: str | Path) -> None:
    """Write a recording as a folder (without depth maps)."""
    writer = FolderWriter(folder, recording.name, "common" if recording.common_clock else "own")
    for s in recording.streams:
        for n, time in enumerate(s.times.tolist()):
            seen = np.flatnonzero(s.person_ids[n] >= 0)
            if not len(seen):
                writer.add(empty_report(s.name, time))
            for c in seen.tolist():
                person = int(s.person_ids[n, c])
                writer.add(SensorReport(s.name, time, person, s.joint_names, s.positions[n, c], s.state[n, c]))
    writer.close()
