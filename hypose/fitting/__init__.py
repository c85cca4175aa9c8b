"""Fitting: the one articulated least-squares core that trackers, fusion, subject and calibration share.

Evidence becomes rows, rows normal equations, equations a bounded robust step, and `problem.Problem.solve` decides how
far to trust it:
- one pose: rows -> 6 x 6 sums per bone -> folded up the tree -> a dense bounded step, all compiled (`fit_pose`);
- a clip: the same sums of every frame, coupled to the next two, solved as a band (`fit_clip`);
- poses, boards or points that share a shape or cameras: groups eliminated (`problem.SharedProblem`; of poses
  `PoseProblem`, whose derivatives all follow from `Rows`).
A new residual is a `RowTerm` (hypose.evidence.terms; Python, no kernel), or, where it must be fast, one kernel in
compute.rows and one term; losses and factorisations are those of `compute` for all.
"""

from hypose.fitting.articulated import PoseFit, SolveSettings, fit_pose, fit_poses
from hypose.fitting.clip_solve import Coupling, Gaussian, fit_clip
from hypose.fitting.problem import Quadratic

__all__ = ["Coupling", "Gaussian", "PoseFit", "Quadratic", "SolveSettings", "fit_clip", "fit_pose", "fit_poses"]
