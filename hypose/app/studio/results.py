"""Read results for the View screen: facts for lists, the block of bytes to show, thumbnails and gait."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path
from typing import Any

import numpy as np

from hypose.app.reports.result_pictures import close_up, draw_skeleton, jpeg
from hypose.app.studio.catalog import Catalog, Item, NotFound, changed
from hypose.app.studio.job_kinds import Plan
from hypose.app.studio.pictures import OpenRecording
from hypose.app.studio.recordings import Recordings
from hypose.app.studio.view_bundle import (
    ViewResult,
    body_of_result,
    first_frame,
    gait_values,
    load_view,
    quality_of,
    view_bundle,
)
from hypose.errors import HyposeError
from hypose.io.motions.results import Checkpoint, load_body, load_motion
from hypose.tracking.tracker import estimates_from_arrays, motion_of

_READ = ("motion.npz", "body.npz", "assessment.json", "modes.npz")
"""Files of a result that its facts are read from."""
_SIZE = (192, 144)
"""Width and height of a thumbnail, px."""
Stamp = tuple[float | None, ...]


class Results:
    """Provider of the data that the View screen of the studio shows of results. Several threads may use it.

    catalog: items of the served folder.
    recordings: open recordings of the studio.
    """

    def __init__(self, catalog: Catalog, recordings: Recordings) -> None:
        self._catalog, self._recordings = catalog, recordings
        self._heads: dict[str, tuple[Stamp, dict[str, Any]]] = {}
        self._one = threading.Lock()  # one thread at a time loads a whole motion, since it is large

    def block(self, item: Item) -> bytearray:
        """Pack a result into the block of bytes that the View screen reads (layout: `view_bundle`)."""
        with self._one:
            return view_bundle(load_view(item.path))

    def pictures(self, item: Item) -> OpenRecording:
        """Open the pictures of a result's recording; results of the same frames share them.

        Raises: NotFound where there is no recording.
        """
        folder = self._catalog.recording_of(item.path)
        if folder is None:
            raise NotFound("The result is in no recording's folder, so there are no pictures of it.")
        facts = self.head(item)  # the motion itself, which may be large, is not needed
        return self._recordings.opened(folder, (facts["first_frame"], facts["first_frame"] + facts["frames"]))

    def head(self, item: Item) -> dict[str, Any]:
        """Return the facts of a result for the list of results: title, method, frames, rate and quality.

        Returns: JSON values, read again where files of the result have changed; "frames" is 0 where the motion cannot
            be read.
        """
        stamp, known = _stamp(item.path), self._heads.get(item.id)
        if known is None or known[0] != stamp:
            with self._one:
                known = self._heads[item.id] = stamp, self._read_head(item, stamp)
        return known[1]

    def _read_head(self, item: Item, stamp: Stamp) -> dict[str, Any]:
        """Read the facts of a result; stamp: times of change of its files."""
        folder = self._catalog.recording_of(item.path)
        recipe, correctable, quality, first = "unknown", False, {}, 0
        try:
            motion = load_motion(item.path / "motion.npz")
            frames, rate = len(motion), motion.frame_rate
            recipe = str(motion.provenance.get("recipe", recipe))
            first = first_frame(motion)
            correctable = folder is not None and motion.poses is not None and not (item.path / "modes.npz").exists()
            quality = quality_of(item.path, motion)
        except HyposeError:
            frames, rate = 0, 0.0
        return {
            "id": item.id,
            "title": f"{folder.name}: {item.path.name}" if folder is not None else item.path.name,
            "name": item.path.name,
            "path": self._catalog.shown(item.path),
            "recording": self._catalog.id_of("recording", folder) if folder is not None else None,
            "recipe": recipe,
            "frames": frames,
            "first_frame": first,
            "frame_rate": rate,
            "seconds": frames / rate if rate else 0.0,
            "complete": frames > 0 and not (item.path / "checkpoint.npz").exists(),
            "changed": stamp[0] or item.changed,
            "correctable": correctable,
            "pictured": folder is not None,
            **quality,
        }

    def thumbnail(self, item: Item) -> bytes:
        """Make a JPEG of 192 x 144 px around the person in the middle frame, with the skeleton.

        Returns: the file's bytes. The picture is that of the first camera that has one; the first frame is shown where
            no camera has a picture of the middle one.
        Raises: NotFound where there are no pictures; InputError where the motion cannot be read.
        """
        motion = load_motion(item.path / "motion.npz")
        seen = np.flatnonzero(np.isfinite(motion.joints).all((1, 2))).tolist()
        opened = self.pictures(item)
        for row in seen and [seen[len(seen) // 2], seen[0]]:
            if (found := opened.first_picture(row)) is not None:
                small, camera = close_up(*found, motion.joints[row], _SIZE, 1.5)
                draw_skeleton(small, camera, motion.skeleton, motion.joints[row])
                return jpeg(small, _SIZE[0])
        raise NotFound("There are no pictures of this result.")

    def gait(self, item: Item) -> dict[str, Any]:
        """Compute the gait of a result for the page (`gait_values`); it is empty where files cannot be read."""
        with self._one, contextlib.suppress(HyposeError):
            motion = load_motion(item.path / "motion.npz")
            return gait_values(motion, body_of_result(item.path, motion))
        return {"events": [], "figures": [], "cycles": []}

    def so_far(self, plan: Plan, began: float | None) -> bytearray | None:
        """Pack the frames that a job has tracked so far into the block of bytes that the View screen reads.

        The frames are those of the job's checkpoint; without a checkpoint, those of the finished result.
        plan: command of the job.
        began: time at which the job began, s since 1970; a result that is older belongs to another job. None: it has
            not begun.
        Returns: the block (layout: `view_bundle`); None while there are no frames.
        Raises: NotFound where the job makes no motion, or its method keeps none that can be shown before the end.
        """
        folder = plan.folder
        if folder is None or plan.recording is None:
            raise NotFound("This job makes no motion.")
        recording = self._recordings.load(self._catalog.find("recording", plan.recording))
        checkpoint, motion = folder / "checkpoint.npz", folder / "motion.npz"
        if not checkpoint.is_file():
            if began is None or (changed(motion) or 0.0) < began:
                return None
            return view_bundle(load_view(folder, recording))
        saved = Checkpoint.read(checkpoint)
        first_person = "0_done_"  # a checkpoint holds all people
        done = {k.removeprefix(first_person): v for k, v in saved.arrays.items() if k.startswith(first_person)}
        if not done:
            return None
        if not {"poses", "joint_covariances", "flags"} <= done.keys():
            raise NotFound("What this method has tracked so far cannot be shown; wait for its end.")
        estimates, body = estimates_from_arrays(done), load_body(folder / "body.npz")
        times = np.arange(len(estimates)) / recording.frame_rate
        tracked = motion_of(body, times, estimates, saved.identity)
        first = first_frame(tracked)
        return view_bundle(ViewResult(recording.name, tracked, body, recording, first_frame=first, complete=False))


def _stamp(folder: Path) -> Stamp:
    """Return the times of change of the files that a result's facts are read from, to notice changes.

    Returns: s since 1970 by file, None where it does not exist; last 1 where there is a checkpoint, which changes.
    """
    return *(changed(folder / name) for name in _READ), float((folder / "checkpoint.npz").exists())
