"""Articulated least-squares fitting, shared by trackers, fusion, subject estimation and calibration.

Evidence becomes rows (linearised residuals), rows become normal equations, and these give a bounded robust step;
`problem.Problem.solve` controls the damping. There are three kinds of problems:
- one pose: rows are summed to 6 x 6 matrices per joint and folded up the joint tree to a dense bounded step, all
compiled (`fit_pose`);
- a clip: the same sums of every frame, coupled to the next two frames, solved as a band matrix (`fit_clip`);
- poses, boards or points that share a shape or cameras: the groups are eliminated (`problem.SharedProblem`; for poses
`PoseProblem`, whose derivatives all follow from `Rows`).
A new residual is a `RowTerm` (hypose.evidence.terms; Python, no kernel), or, where it must be fast, one kernel in
compute.rows and one term. Losses and factorisations of all problems are those of `compute`.
"""

from hypose.fitting.articulated import PoseFit, SolveSettings, fit_pose, fit_poses
from hypose.fitting.clip_solve import Coupling, Gaussian, fit_clip
from hypose.fitting.problem import Quadratic

__all__ = ["Coupling", "Gaussian", "PoseFit", "Quadratic", "SolveSettings", "fit_clip", "fit_pose", "fit_poses"]
