"""Whether simulated depth cameras err as real ones do: noise about local planes, holes and values between both sides at
edges; an Azure Kinect's frame, hands before a Kinect of the first generation, and a simulated frame."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.depth_sensors.depth_tracking import scene_of
from hypose.geometry import Array
from hypose.io.sensors.depth import read_azure_mkv, read_depth_png
from hypose.synthetic.depth_scenes import FOCAL_PX, KINECT_SIZE, SensorFaults, sensed

_WINDOW = 9
_BINS = ((0.6, 0.9), (0.9, 1.5), (1.5, 2.5), (2.5, 3.5), (3.5, 5.5))
_JUMP_M = 0.1
_EVERY = 60
"""of the hands' pictures"""


def depth_noise(options: BenchOptions) -> BenchReport:
    """noise_mm: the calmest fifth of the sds about planes of 9 x 9 px, by distance, of surfaces that are seen at less
    than 60 degrees; edge_holes, edge_between: shares of the pixels beside a jump of 10 cm, and of the measured ones
    among them. Simulated: walls in the middle of each range of
    distances, and edges of the frames of seed 700."""
    _, frames = read_azure_mkv(options.folder("azure_kinect_mkv") / "recording.mkv")
    azure = [next(iter(frames)).depth]
    files = sorted(options.folder("asl_depth_crops").glob("*/*.png"))[::_EVERY]
    hands = [read_depth_png(f) for f in files]
    scene = scene_of(700, "depth-1", 0.2, options)
    camera, shape = scene.rig[0], KINECT_SIZE[::-1]
    rng = np.random.default_rng(700)
    walls = [np.full(shape, sum(b) / 2, np.float32) for b in _BINS]
    pattern = np.zeros(shape, np.float32)
    simulated = [sensed(w, camera, SensorFaults(), pattern, rng, 0, None) for w in walls]
    people = [scene.depth_map(0, k) for k in range(4)]
    rows: list[Row] = []
    for name, maps, focal in (("azure", azure, 504.0), ("kinect", hands, 575.0), ("simulated", simulated, FOCAL_PX)):
        # walls have no edges, and people no planes
        found = np.concatenate([p for m in maps if len(p := _planes(m, focal))])
        for low, high in _BINS:
            own = found[(found[:, 0] >= low) & (found[:, 0] < high), 1]
            if len(own) >= 30:
                value = 1e3 * float(np.percentile(own, 20))
                rows.append(Row("noise_mm", f"{name}/{low:g}-{high:g}", value, "mm", None, len(own)))
        holes, between = np.mean([e for m in (people if name == "simulated" else maps) for e in _edges(m)], axis=0)
        rows.append(Row("edge_holes", name, float(holes), "1", None, len(maps)))
        rows.append(Row("edge_between", name, float(between), "1", None, len(maps)))
    return BenchReport(tuple(rows), {"hands": len(hands), "simulated_size": list(KINECT_SIZE)})


def _planes(depth: NDArray[np.float32], focal_px: float) -> Array:
    """(N, 2): distance and sd of the residuals, m, of windows without holes that lie on one plane."""
    n = _WINDOW
    v, u = np.mgrid[:n, :n]
    plane = np.stack([u.ravel(), v.ravel(), np.ones(n * n)], 1).astype(np.float64)
    solve = np.linalg.pinv(plane)
    out = []
    for y in range(0, depth.shape[0] - n, n):
        for x in range(0, depth.shape[1] - n, n):
            z = depth[y : y + n, x : x + n].ravel().astype(np.float64)
            if (z <= 0).any():
                continue
            fit = solve @ z
            slope = fit[:2] * focal_px / z.mean()
            if 1 / np.sqrt(1 + slope @ slope) < 0.5 or np.ptp(z) > _JUMP_M:
                continue
            out.append((z.mean(), np.sqrt(((z - plane @ fit) ** 2).sum() / (n * n - 3))))
    return np.array(out).reshape(-1, 2)


def _edges(depth: NDArray[np.float32]) -> Iterator[tuple[float, float]]:
    kernel = np.ones((5, 5), np.uint8)
    near = cv2.erode(np.where(depth > 0, depth, 99).astype(np.float32), kernel)
    far = cv2.dilate(depth, kernel)
    edge = (near < 90) & (far - near > _JUMP_M)
    if not edge.any():
        return
    seen = edge & (depth > 0)
    quarter = 0.25 * (far - near)
    between = seen & (depth > near + quarter) & (depth < far - quarter)
    yield float((depth[edge] == 0).mean()), float(between.sum() / max(seen.sum(), 1))
