"""Refinement of cameras and poses from the person's silhouettes, with the tracked body as calibration object.

Unknowns are one pose per frame and six numbers per camera (seven with the focal length). Rows are those of the shape
and pose solvers: two-way contour distances with a Geman-McClure weight. A row depends on the pose of its frame and on
its own camera, so poses are eliminated frame by frame (Schur complement) and a step solves one small system for all
cameras. The body is fixed, and with it the scale.
Sources: Geman and McClure 1985; contour rows as in Gall et al. 2009. No published method refines extrinsics from
    silhouettes of an articulated body in this way; the nearest is Sinha and Pollefeys 2010 (frontier points).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.calibration.bundle import apply_parameters
from hypose.calibration.refine_points import CameraUnknowns, by_camera
from hypose.cameras.camera import Camera, CameraRig
from hypose.errors import EvidenceError
from hypose.evidence.terms import ContourTerm
from hypose.fitting.problem import Cue, Posed, PoseProblem, Quadratic, Rows
from hypose.fitting.rows import rows_of_contours
from hypose.geometry import Array, transform
from hypose.tracking.refinement import anatomical_prior

_Cameras = list[Camera]


_NORMALS = 0.3
"""Smallest cosine between the outline normals of a row; other rows are left out."""


_COARSE, _ITERATIONS = (4.0, 2.0, 1.0), (5, 6, 6)
"""Factors of the contour scale, and number of iterations, of each stage."""


@dataclass(frozen=True)
class BodyAdjustment:
    """The result of a refinement with a body.

    rig: refined cameras, at the size of the given ones.
    poses: (F, D) refined poses.
    """

    rig: CameraRig
    poses: Array


def adjust_with_body(
    body: Body,
    rig: CameraRig,
    poses: Array,
    evidence: Sequence[Sequence[ContourTerm]],
    free: NDArray[np.bool_] | None = None,
    *,
    focal: bool = False,
) -> BodyAdjustment:
    """Refine a rig of pinhole cameras and the poses of a body in F frames.

    rig: cameras at the working size of the evidence; the projections inside the terms are not used.
    poses: (F, D) start poses.
    evidence: outlines of each frame.
    free: (C,) cameras that may move; None for all.
    focal: refine focal lengths as well.
    Raises: EvidenceError where no frame has evidence.
    """
    cues = [[_cue(one) for one in of] for of in evidence]
    if not any(cues):
        raise EvidenceError("No frame has silhouettes to refine the calibration with; choose other frames.")
    problem = _BodyProblem(body, cues, [anatomical_prior(body.skeleton)], CameraUnknowns(rig, focal, free))
    cameras, q = problem.stages((list(rig), np.array(poses, dtype=np.float64)), _COARSE, _ITERATIONS, 1e-4).state
    return BodyAdjustment(CameraRig(tuple(cameras)), q)


def _cue(one: ContourTerm) -> Cue[_Cameras]:
    """Make the function that gives the rows of an outline in the images of the present cameras."""

    def rows(at: Posed, cameras: _Cameras, factor: float) -> Iterable[Rows]:
        projections = np.stack([c.projection for c in cameras])
        return rows_of_contours(at, one, factor, 1.0, one.row_spacing_px, _NORMALS, projections)

    return rows


class _BodyProblem(PoseProblem[_Cameras]):
    """Least-squares problem of `adjust_with_body`; the cameras are shared by all frames."""

    largest = 0.1

    def __init__(
        self,
        body: Body,
        frames: Sequence[Sequence[Cue[_Cameras]]],
        priors: Sequence[Quadratic],
        unknowns: CameraUnknowns,
    ) -> None:
        super().__init__(body, frames, priors)
        self.unknowns, self.free, self.limited = unknowns, unknowns.free, unknowns.turns

    def shared_cost(self, shared: _Cameras, body: Body) -> float:
        return self.unknowns.held(shared)[1]

    def shared_moved(self, shared: _Cameras, step: Array) -> _Cameras:
        return [apply_parameters(c, x) for c, x in zip(shared, step.reshape(len(shared), -1), strict=True)]

    def shared_rows(
        self, shared: _Cameras, posed: Sequence[Posed], rows: Sequence[Rows]
    ) -> tuple[Array, Array, Sequence[Array]]:
        hold, count = self.unknowns.hold, self.unknowns.count
        by_frame = []
        for r in rows:
            by_all = np.zeros((len(r.view), len(shared), count))
            for c, camera in enumerate(shared):
                own, turn = r.view == c, camera.camera_from_world[:3, :3]
                by_all[own, c] = by_camera(
                    transform(camera.camera_from_world, r.point[own]), r.slope[own] @ turn.T, count
                )
            by_frame.append(by_all.reshape(len(r.view), -1))
        return np.diag(np.tile(hold, len(shared))), (hold * self.unknowns.held(shared)[0]).ravel(), by_frame
