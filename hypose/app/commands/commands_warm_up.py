"""`hypose warm-up`: what would be compiled on first use, compiled now."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hypose.app.commands.commands_track import set_threads
from hypose.app.commands.console import Stages, say
from hypose.app.commands.options import Threads
from hypose.errors import InputError


def warm_up(threads: Threads = None) -> None:
    """Compile what tracking, fusing and live need, so that the first run of each begins at once; once per machine, and
    again after an update. Ends with a third of a second of a made-up person tracked, report and all."""
    set_threads(threads)
    from hypose import compute
    from hypose.app.jobs.job import Job, run_job
    from hypose.fusion.live import LiveFuser
    from hypose.io.motions.results import ResultsFolder
    from hypose.io.recordings.recording import load_recording
    from hypose.pipeline.run import TrackOptions
    from hypose.synthetic.scenes import make_scene
    from hypose.synthetic.write_recording import write_scene

    folder, parts = compute.cache_folder(), (*compute.FOLLOWING, "monocular", "depth")
    if folder is None:
        raise InputError(f"There is no place for what is compiled; name a folder with {compute.VARIABLE}.")
    before = compute.kept(*parts)
    with tempfile.TemporaryDirectory(prefix="hypose-warm-up-") as temporary, Stages() as progress:
        progress("compile", 0, 1)
        compute.warm_up(*parts, load=False)
        LiveFuser()
        progress("compile", 1, 1)
        scene, place = make_scene("walk", rig="humaneva-4", seconds=0.32, seed=1), Path(temporary)
        write_scene(scene, place, progress=lambda done, total: progress("render", done, total))
        run_job(Job(load_recording(place), TrackOptions(), ResultsFolder(place / "results")), progress)
    if not compute.kept(*parts):
        raise InputError(
            f"What was compiled could not all be kept in {folder}; make space there, see that it can be written, or "
            f"name another folder with {compute.VARIABLE}, and run this again."
        )
    say("All of it had been compiled." if before else f"Compiled; kept in {folder}")
