"""What a job has tracked so far, to watch it run: read from its checkpoint, which nothing here changes."""

from __future__ import annotations

import numpy as np

from hypose.app.studio.catalog import Catalog, NotFound
from hypose.app.studio.job_kinds import Plan
from hypose.app.studio.recordings import Recordings
from hypose.app.studio.view_bundle import ViewResult, pictured, view_bundle
from hypose.app.studio.view_result import load_view
from hypose.io.motions.results import Checkpoint, load_body
from hypose.tracking.tracker import estimates_from_arrays, motion_of


def block_so_far(plan: Plan, began: float | None, catalog: Catalog, recordings: Recordings) -> bytearray | None:
    """The block of a result under way, or of the finished one; None while there is nothing, NotFound when there never
    will be. began: when the job did (s); what lies there from before is not its own."""
    folder = plan.folder
    if folder is None or plan.recording is None:
        raise NotFound("This job makes no motion.")
    recording = recordings.load(catalog.find("recording", plan.recording))
    checkpoint, motion = folder / "checkpoint.npz", folder / "motion.npz"
    if not checkpoint.is_file():
        if began is None or not motion.is_file() or motion.stat().st_mtime < began:
            return None
        return view_bundle(load_view(folder, recording))
    saved = Checkpoint.read(checkpoint)
    done = {k.removeprefix("done_"): v for k, v in saved.arrays.items() if k.startswith("done_")}
    if not {"poses", "joint_covariances", "flags"} <= done.keys():
        raise NotFound("What this method has tracked so far cannot be shown; wait for its end.")
    estimates, body = estimates_from_arrays(done), load_body(folder / "body.npz")
    times = np.arange(len(estimates)) / recording.frame_rate
    frames = saved.identity.get("settings", {}).get("frames")
    shown = ViewResult(
        recording.name,
        motion_of(body, times, estimates, saved.identity),
        body,
        recording.rig,
        [v.image_shift for v in recording.views],
        pictured(recording),
        int(frames[0]) if frames else 0,
        complete=False,
    )
    return view_bundle(shown)
