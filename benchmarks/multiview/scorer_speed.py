"""Benchmark of the silhouette scorer: its speed against OpenCV in the same run, its exactness, and what the coarse mesh
costs in ranking."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.stats import spearmanr

from benchmarks.bench_report import BenchOptions, BenchReport, Row, best
from benchmarks.multiview.action_scenes import action_scene, known_subject
from hypose.body.body import Body, Mesh
from hypose.compute.arrays import PreparedMasks, prepare_masks
from hypose.compute.parts import covered, projected
from hypose.compute.scorer import silhouette_xor
from hypose.evidence.frame import Frame
from hypose.geometry import Array


def silhouette_scorer(options: BenchOptions) -> BenchReport:
    """Microseconds per silhouette (one pose, one view, 640 x 480) with 1 and 2 threads; OpenCV filling every
    front-facing triangle as baseline; and Spearman's correlation of the coarse mesh's ranking of poses with the fine
    mesh's."""
    scene = action_scene("walk", 0, 0.2, options)
    frame = next(iter(scene.mask_frames(1.0)))
    subject = known_subject(scene)
    body = subject.body
    assert frame.silhouettes is not None
    masks = frame.silhouettes.prepared
    tree, mesh = body.skeleton.tree, body.coarse.arrays
    n = 96 if options.quick else 500
    poses = around(body, subject.start, 2 * body.skeleton.sigma, n)
    views, repeats = len(masks.masks), 7 if options.quick else 25
    silhouette_xor(poses[:8], tree, mesh, masks)
    opencv = best(_opencv_call(body, poses[:4], masks), 5) / (4 * views) * 1e6
    against = {"baseline": "OpenCV fillConvexPoly per front triangle, 1 thread", "baseline_value": opencv}
    rows = []
    for threads in (1, 2):
        seconds = best(lambda t=threads: silhouette_xor(poses, tree, mesh, masks, threads=t), repeats)
        value = seconds / (n * views) * 1e6
        rows.append(Row("us_per_silhouette", f"{threads}t", value, "us", n=n, **against))
        rows.append(Row("ratio_to_opencv", f"{threads}t", value / opencv, "1"))
    rest = body.skeleton.rest_pose()
    rest[:6] = subject.start[:6]
    for case, pose in (("standing", rest), ("walking", subject.start)):
        value = _ranking(body, pose, masks, 100 if options.quick else 500)
        rows.append(Row("spearman_to_fine", case, value, "1", n=100 if options.quick else 500))
    settings = {"views": views, "size": [640, 480], "vertices": len(body.coarse.vertices), "poses": n}
    return BenchReport(tuple(rows), settings)


def opencv_unit(frame: Frame, body: Body, pose: Array) -> float:
    """Seconds that OpenCV needs for one silhouette: what the speed of other things is divided by on a noisy machine."""
    assert frame.silhouettes is not None
    masks = frame.silhouettes.prepared
    return best(_opencv_call(body, around(body, pose, body.skeleton.sigma, 4), masks), 5) / (4 * len(masks.masks))


def around(body: Body, pose: Array, sd: Array, n: int) -> Array:
    """(N, D) poses about one, within the limits."""
    return body.skeleton.clamp(pose + np.random.default_rng(0).standard_normal((n, len(pose))) * sd)


def _silhouette(vertices: Array, faces: np.ndarray, projection: Array, size: tuple[int, int]) -> np.ndarray:
    uv, z, _ = projected(vertices, projection)
    return covered(uv, z, faces, size[::-1])


def _ranking(body: Body, pose: Array, masks: PreparedMasks, n: int) -> float:
    """Spearman's correlation of XORs by the coarse and by the fine mesh, poses 2 degrees and 1 cm around one; the masks
    are the fine mesh's own at that pose."""
    vertices = body.skin(pose, body.fine)
    own = [
        _silhouette(vertices, body.fine.faces, p, (int(w), int(h)))
        for p, (w, h) in zip(masks.projections, masks.sizes, strict=True)
    ]
    prepared = prepare_masks(np.stack(own), np.ones(len(own), bool), masks.sizes, masks.projections)
    sd = np.where(np.arange(len(pose)) < 3, 0.01, np.deg2rad(2))
    poses = around(body, pose, sd, n)

    def energies(level: Mesh) -> Array:
        counts = silhouette_xor(poses, body.skeleton.tree, level.arrays, prepared)
        return (counts[..., 0] / prepared.areas).sum(1)

    return float(spearmanr(energies(body.coarse), energies(body.fine)).statistic)  # pyright: ignore[reportAttributeAccessIssue]


def _opencv_call(body: Body, poses: Array, masks: PreparedMasks):  # noqa: ANN202 - () -> counts
    """The obvious way: project, fill every front-facing triangle with OpenCV, XOR. (Skinning, which is numpy's and
    slower than all of the scorer, is not counted.)"""
    vertices, faces = body.skin(poses), body.coarse.faces

    def call() -> Array:
        out = np.zeros((len(poses), len(masks.masks)))
        for n, v in enumerate(vertices):
            for c, (mask, projection) in enumerate(zip(masks.masks, masks.projections, strict=True)):
                h = v @ projection[:, :3].T + projection[:, 3]
                uv = h[:, :2] / h[:, 2:]
                a, b, d = uv[faces[:, 0]], uv[faces[:, 1]], uv[faces[:, 2]]
                front = (b[:, 0] - a[:, 0]) * (d[:, 1] - a[:, 1]) - (d[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1]) < 0
                image = np.zeros_like(mask)
                for triangle in np.round(uv[faces[front]]).astype(np.int32):
                    cv2.fillConvexPoly(image, triangle, 1)
                out[n, c] = np.count_nonzero(image != mask)
        return out

    return call
