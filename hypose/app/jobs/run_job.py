"""A tracking job from its recording to its report, with the method that its options are for."""

from __future__ import annotations

from collections.abc import Mapping

from hypose.app.commands.console import ProgressCall, ignore
from hypose.app.jobs.job import Job, Outcome, run_multiview_job
from hypose.app.jobs.mono_job import run_mono_job
from hypose.pipeline.monocular import MonoOptions


def run_job(job: Job, progress: ProgressCall = ignore, seconds: Mapping[str, float] | None = None) -> Outcome:
    """Track, export, draw and report. seconds: filled by the progress while this runs, read for the report.

    KeyboardInterrupt while tracking gives an Outcome with complete=False (what is done is on disk); in any other stage
    it is passed on.
    """
    if isinstance(job.options, MonoOptions):
        return run_mono_job(job, job.options, progress, seconds)
    return run_multiview_job(job, job.options, progress, seconds)
