"""Speed of the contour solve."""

from __future__ import annotations

import numpy as np

from hypose.evaluation.benchmarks import BenchOptions, BenchReport, Row, row
from hypose.evaluation.published import action_scene, known_subject
from hypose.evaluation.timing import best
from hypose.fitting.articulated import SolveOptions, contour_term, fit_pose
from hypose.tracking.refinement import anatomical_prior, prediction_prior


def contour_solve(options: BenchOptions) -> BenchReport:
    """Milliseconds per frame of the robust contour solve (8 iterations, 4 views) and its iterations."""
    scene = action_scene("walk", 0, 0.4 if options.quick else 1.0, options)
    subject = known_subject(scene)
    body, start = subject.body, subject.start
    rows = []
    for case, scale in (("contours", 1.0), ("contours, half size", 0.5)):
        seconds, iterations, pose = [], [], start
        for frame in scene.mask_frames(scale):
            assert frame.silhouettes is not None
            term = contour_term(frame.silhouettes)
            priors = (anatomical_prior(body.skeleton), prediction_prior(pose, 0.1))
            fit = fit_pose(body, pose, contours=term, priors=priors, options=SolveOptions())
            seconds.append(
                best(
                    lambda q=pose, t=term, p=priors: fit_pose(body, q, contours=t, priors=p, options=SolveOptions()), 3
                )
            )
            iterations.append(fit.iterations)
            pose = fit.pose
        rows.append(row("ms_per_frame", case, 1e3 * np.array(seconds), "ms"))
        rows.append(Row("iterations_p90", case, float(np.percentile(iterations, 90)), "1", n=len(iterations)))
    return BenchReport(tuple(rows), {"views": 4, "iterations": 8, "dof": body.skeleton.dof})
