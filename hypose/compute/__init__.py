"""Compute: the only room whose code numba compiles; every hot function takes and returns arrays.

A kernel is a function under `compiled.kernel`; public functions here check and tidy arrays, call kernels and spread
work over threads. This module is the room's only door: names that are not listed here are not used outside (checked
with the import contracts).
"""

from __future__ import annotations

from hypose.compute import depth_sensor, forest_votes, forests, fusion, mask_runs, mono, picture_to_mask, reach
from hypose.compute.arrays import (
    BALL,
    FIXED,
    HINGES,
    NO_CONTOURS,
    NO_KEYPOINTS,
    NO_POINTS,
    NOT_KNOWN,
    ContourArrays,
    Cues,
    DepthArrays,
    KeypointArrays,
    MeshArrays,
    PointArrays,
    PreparedMasks,
    PriorArrays,
    SolveLimits,
    Standing,
    TreeArrays,
    Workspace,
    plain,
    prepare_masks,
)
from hypose.compute.compiled import VARIABLE, cache_folder
from hypose.compute.depth_costs import (
    SeenDepth,
    StandingDepth,
    depth_energy,
    limb_depth_energy,
    limb_shown,
    standing_depth,
)
from hypose.compute.depth_points import (
    before_room,
    holes_filled,
    middle,
    middle_of_piece,
    points_of_surface,
    things_before,
)
from hypose.compute.forest_votes import Packed, ScanPlan
from hypose.compute.forests import DepthImage, GrowingArrays, PaddedDepth
from hypose.compute.glance import Glance, differing_box, glance_at, stored_pixels
from hypose.compute.kinematics import forward_kinematics, joint_covariances, joint_jacobians, skin
from hypose.compute.linear import SharedEquations, frame_covariances, solve_coupled, weighted_squares
from hypose.compute.losses import geman_mcclure, huber, lorentzian, lorentzian_weight
from hypose.compute.mask_distance import shrink_mask, signed_distance
from hypose.compute.mask_runs import mask_of
from hypose.compute.mono_terms import (
    GAUSSIAN,
    LECLERC,
    LORENTZIAN,
    EdgeArrays,
    FloorArrays,
    FlowArrays,
    MarkArrays,
    MaskArrays,
    MonoModel,
    MonoPriors,
    MonoProblem,
    MonoWorkspace,
    SphereArrays,
)
from hypose.compute.part_colours import colour_sums, rim_edges, shown_parts
from hypose.compute.parts import covered, draw_parts, parts_against_mask, projected, touched_area
from hypose.compute.picture_to_mask import (
    Box,
    Undistortion,
    make_lens,
    new_picture,
    order_statistic,
    shrink_undistort,
)
from hypose.compute.rows import outline_points
from hypose.compute.scorer import limb_energies, silhouette_xor
from hypose.compute.shape_rows import outline_rows
from hypose.compute.solver import Evaluation, Solution, bounded_step, evaluate, solve, workspace
from hypose.compute.threads import default_threads, in_background, over_chunks
from hypose.compute.visibility import nearest_visible
from hypose.compute.warming import TRACKING_KERNELS, kept, warm_up
from hypose.compute.zbuffer import interpolate, rasterize

__all__ = [
    "BALL",
    "Box",
    "ContourArrays",
    "Cues",
    "DepthImage",
    "DepthArrays",
    "EdgeArrays",
    "Evaluation",
    "FIXED",
    "TRACKING_KERNELS",
    "FloorArrays",
    "FlowArrays",
    "GAUSSIAN",
    "Glance",
    "GrowingArrays",
    "HINGES",
    "KeypointArrays",
    "LECLERC",
    "LORENTZIAN",
    "Undistortion",
    "MarkArrays",
    "MaskArrays",
    "MeshArrays",
    "MonoModel",
    "MonoPriors",
    "MonoProblem",
    "MonoWorkspace",
    "NOT_KNOWN",
    "NO_CONTOURS",
    "NO_KEYPOINTS",
    "NO_POINTS",
    "Packed",
    "PaddedDepth",
    "PointArrays",
    "PreparedMasks",
    "PriorArrays",
    "ScanPlan",
    "SeenDepth",
    "SharedEquations",
    "Solution",
    "SolveLimits",
    "SphereArrays",
    "Standing",
    "StandingDepth",
    "TreeArrays",
    "VARIABLE",
    "Workspace",
    "before_room",
    "in_background",
    "bounded_step",
    "cache_folder",
    "colour_sums",
    "covered",
    "default_threads",
    "depth_energy",
    "depth_sensor",
    "differing_box",
    "draw_parts",
    "evaluate",
    "forest_votes",
    "forests",
    "forward_kinematics",
    "frame_covariances",
    "fusion",
    "geman_mcclure",
    "glance_at",
    "holes_filled",
    "huber",
    "interpolate",
    "joint_covariances",
    "joint_jacobians",
    "kept",
    "limb_depth_energy",
    "limb_energies",
    "limb_shown",
    "lorentzian",
    "lorentzian_weight",
    "make_lens",
    "mask_of",
    "mask_runs",
    "middle",
    "middle_of_piece",
    "mono",
    "nearest_visible",
    "new_picture",
    "order_statistic",
    "outline_points",
    "outline_rows",
    "over_chunks",
    "parts_against_mask",
    "picture_to_mask",
    "plain",
    "points_of_surface",
    "prepare_masks",
    "projected",
    "rasterize",
    "reach",
    "rim_edges",
    "shown_parts",
    "shrink_mask",
    "shrink_undistort",
    "signed_distance",
    "silhouette_xor",
    "skin",
    "solve",
    "solve_coupled",
    "standing_depth",
    "stored_pixels",
    "things_before",
    "touched_area",
    "warm_up",
    "weighted_squares",
    "workspace",
]
