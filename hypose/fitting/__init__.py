"""Fitting: the one articulated solver that trackers, fusion, subject and calibration share."""

from hypose.fitting.articulated import (
    ContourTerm,
    KeypointTerm,
    PointTerm,
    PoseFit,
    Quadratic,
    SolveOptions,
    contour_term,
    fit_pose,
    fit_poses,
    workspace_for,
)
from hypose.fitting.clip_solve import Coupling, Gaussian, fit_clip
from hypose.fitting.own_rows import RowTerm

__all__ = [
    "ContourTerm",
    "Coupling",
    "Gaussian",
    "KeypointTerm",
    "PointTerm",
    "RowTerm",
    "PoseFit",
    "Quadratic",
    "SolveOptions",
    "contour_term",
    "fit_clip",
    "fit_pose",
    "fit_poses",
    "workspace_for",
]
