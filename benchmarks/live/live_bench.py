"""How fast, how late and how well people are followed live: a server of virtual cameras in a process of its own plays
clips as motion JPEG over the loopback, and everything else runs on the same processor."""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from websockets.sync.client import connect

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.synthetic.virtual_cameras import CameraFaults, VirtualCameras, there_and_back
from hypose.app.live.pose_outputs import PoseOutputs
from hypose.cameras.camera import CameraRig
from hypose.geometry import Array
from hypose.io.recordings.recording import Recording, load_recording
from hypose.io.videos.video import open_video
from hypose.pipeline.live.capture import CaptureOptions
from hypose.pipeline.live.engine import Listener, LiveEngine, LiveResult, LiveStatus
from hypose.pipeline.live.live_people import LivePose
from hypose.pipeline.live.live_rig import LiveRig, live_rig
from hypose.pipeline.track import track
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.scenes import circle, make_scene
from hypose.synthetic.write_recording import write_scene

_CLIP_S = 6.0
_QUALITY = 85
_WITHOUT = CameraFaults()
_FAULTY = CameraFaults(jitter=0.01, lost=0.05, gone=((), (), ((32.0, 37.0),)))
"""5 % of the frames lost, 10 ms jitter, one camera unplugged for 5 s"""
_SPEEDS = {"480p/30": ("humaneva-4", 30.0), "480p/60": ("humaneva-4", 60.0), "1080p/30": ("1080p", 30.0)}
_OFFLINE = "hypose track, frame by frame"
_ERRORS = {"walk": ("walk", _WITHOUT), "combo": ("combo", _WITHOUT), "faults": ("walk", _FAULTY)}


def live(options: BenchOptions) -> BenchReport:
    """poses_per_second (baseline: decoding the same pictures, with as many threads as there are cores), skipped,
    latency_p50_ms and latency_p99_ms (480p/30, 480p/60, 1080p/30); error_ratio (walk, combo, faults): mean error once
    the body is fitted over that of `hypose track` frame by frame; memory_growth_mib (30 min): of all processes, from
    the second minute on; frames_lost (slow client): of a listener beside one that never reads."""
    seconds = 20.0 if options.quick else 60.0
    seed = options.seed_range(1, first=640)[0]
    rows: list[Row] = []
    parts: list[tuple[str, Any]] = [(f"speed-{c}", lambda c=c: _speed(c, seconds, seed)) for c in _SPEEDS]
    parts += [(f"error-{c}", lambda c=c: _error(c, seconds, seed)) for c in _ERRORS]
    parts.append(("client", lambda: _slow_client(seconds, seed)))
    if not options.quick:
        parts.append(("memory", lambda: _memory(30 * 60.0, seed)))
    for done, (name, measure) in enumerate(parts):
        options.progress("recording", done, len(parts))
        found = options.part(f"{name.replace('/', '-')}-{seed}", measure)
        rows += [Row(**r) for r in found["rows"]]
    options.progress("recording", len(parts), len(parts))
    return BenchReport(tuple(rows), {"seconds": seconds, "seed": seed, "clip_s": _CLIP_S, "quality": _QUALITY})


def _speed(case: str, seconds: float, seed: int) -> dict[str, Any]:
    rig, rate = _SPEEDS[case]
    with tempfile.TemporaryDirectory() as temporary:
        recording = _recording(Path(temporary), "walk", rig, rate, seed)
        alone = _decoding(_clips(recording))
        status, _, _ = _run(recording, rate, seconds, _WITHOUT, seed)
    rows = [
        Row("poses_per_second", case, status.per_second, "1/s", baseline="decoding alone", baseline_value=alone),
        Row("skipped", case, 100 * status.skipped, "%"),
        Row("latency_p50_ms", case, status.latency[0], "ms"),
        Row("latency_p99_ms", case, status.latency[1], "ms"),
    ]
    return {"rows": [_plain(r) for r in rows]}


def _error(case: str, seconds: float, seed: int) -> dict[str, Any]:
    motion, faults = _ERRORS[case]
    with tempfile.TemporaryDirectory() as temporary:
        recording = _recording(Path(temporary), motion, "humaneva-4", 30.0, seed)
        truth = np.load(recording.folder / "truth.npz")["joints"]
        one_by_one = track(recording, TrackOptions(smooth=False, seed=seed)).motion
        usual = float(np.linalg.norm(one_by_one.joints - truth[: len(one_by_one)], axis=-1).mean())
        status, poses, begin = _run(recording, 30.0, seconds, faults, seed)
    errors = [_off(p, truth, begin) for p in poses if p.time - poses[0].time > seconds / 3]
    gaps = np.diff([p.time for p in poses])
    lost = sum(p.lost for p in poses)
    rows = [
        Row("error_ratio", case, float(np.mean(errors) / usual), "x", n=len(errors)),
        Row("mean_error_mm", case, 1e3 * float(np.mean(errors)), "mm", baseline=_OFFLINE, baseline_value=1e3 * usual),
        Row("longest_gap_ms", case, 1e3 * float(gaps.max(initial=0.0)), "ms"),
        Row("lost_poses", case, float(lost), "", n=len(poses)),
    ]
    return {"rows": [_plain(r) for r in rows]}


def _slow_client(seconds: float, seed: int) -> dict[str, Any]:
    """Two listeners of the same poses: one reads all of them, one nothing."""
    with tempfile.TemporaryDirectory() as temporary:
        recording = _recording(Path(temporary), "walk", "humaneva-4", 30.0, seed)
        outputs = PoseOutputs(recording.rig.names, 30.0, ws=0, clock=time.monotonic)
        assert outputs.listeners is not None
        address = f"ws://127.0.0.1:{outputs.listeners.port}/out"
        with connect(address) as silent, connect(address) as reading, ThreadPoolExecutor(1) as pool:
            told = pool.submit(lambda: sum('"type":"pose"' in str(m) for m in reading))
            _, poses, _ = _run(recording, 30.0, seconds, _WITHOUT, seed, outputs)
            time.sleep(0.5)
            reading.close()
            got = told.result()
            silent.close()
        outputs.close()
    return {"rows": [_plain(Row("frames_lost", "slow client", float(len(poses) - got), "", n=len(poses)))]}


def _memory(seconds: float, seed: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as temporary:
        recording = _recording(Path(temporary), "walk", "humaneva-4", 30.0, seed)
        watch = _Memory()
        _run(recording, 30.0, seconds, _WITHOUT, seed, watch, keep=False)
    settled = [m for t, m in watch.known if t > watch.known[0][0] + 120]
    fit = np.polyfit(np.arange(len(settled)), settled, 1)[0] * len(settled)
    return {"rows": [_plain(Row("memory_growth_mib", "30 min", float(fit), "MiB", n=len(settled)))]}


class _Memory(Listener):
    """A listener that looks at what this process and those it has started need."""

    def __init__(self) -> None:
        self.known: list[tuple[float, float]] = []

    def status(self, status: LiveStatus) -> None:
        """See `Listener`."""
        self.known.append((time.monotonic(), sum(_resident(p) for p in (os.getpid(), *_children()))))


def _children() -> list[int]:
    return [p.pid for p in multiprocessing.active_children() if p.pid is not None and p.name != "cameras"]


def _resident(process: int) -> float:
    """MiB."""
    try:
        pages = int(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


# ---- scenes and runs -------------------------------------------------------------------------------------------------


def _recording(folder: Path, motion: str, rig: str, rate: float, seed: int) -> Recording:
    cameras: str | CameraRig = rig
    if rig == "1080p":
        cameras = CameraRig(tuple(circle((35, 145, 215, 325), 4.1, (1.2, 1.6, 2.0, 1.4), 1350, (1920, 1080))))
    scene = make_scene(motion, rig=cameras, seconds=_CLIP_S, frame_rate=rate, seed=seed)
    write_scene(scene, folder / "clip")
    return load_recording(folder / "clip")


def _clips(recording: Recording) -> list[list[bytes]]:
    out = []
    for view in recording.views:
        assert view.source is not None
        with open_video(view.source) as reader:
            out.append([_jpeg(picture) for picture in reader])
    return out


def _jpeg(picture: np.ndarray) -> bytes:
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()


def _decoding(clips: Sequence[Sequence[bytes]]) -> float:
    """Instants a second when their pictures are decoded, whole, and nothing else is done."""
    shots = [[np.frombuffer(data, np.uint8) for data in of_instant] for of_instant in zip(*clips, strict=True)][:60]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        begin = time.perf_counter()
        for of_instant in shots:
            list(pool.map(lambda data: cv2.imdecode(data, cv2.IMREAD_COLOR), of_instant))
        return len(shots) / (time.perf_counter() - begin)


class _Kept(Listener):
    """A listener that keeps the poses."""

    def __init__(self) -> None:
        self.poses: list[LivePose] = []

    def seen(self, seen: LiveResult) -> None:
        """See `Listener`."""
        self.poses += seen.poses


def _run(
    recording: Recording,
    rate: float,
    seconds: float,
    faults: CameraFaults,
    seed: int,
    listener: Any = None,
    keep: bool = True,
) -> tuple[LiveStatus, list[LivePose], float]:
    """Follows the person for so long from the first pose on; how it went at the end, the poses, and when the clip
    began (s, monotonic)."""
    cameras: LiveRig = live_rig(recording.folder, {})
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    server = context.Process(target=_serve, args=(there, recording, rate, faults, seed), name="cameras", daemon=True)
    server.start()
    addresses, begin = here.recv()
    views = tuple(replace(v, address=a) for v, a in zip(cameras.views, addresses, strict=True))
    kept = _Kept()
    options = CaptureOptions(rate, silhouettes=cameras.silhouettes)
    listeners = [x for x in (kept if keep else None, listener) if x is not None]
    engine = LiveEngine(cameras.rig, views, options, listeners=listeners)
    try:
        engine.start()
        until = time.monotonic() + 60
        while engine.status().poses == 0 and time.monotonic() < until:
            time.sleep(0.1)
        engine.ended.wait(seconds)
        status = engine.status()
    finally:
        engine.stop()
        here.send(None)
        server.join(5)
    if engine.failed is not None:
        raise engine.failed
    return status, kept.poses, begin


def _serve(pipe: Connection, recording: Recording, rate: float, faults: CameraFaults, seed: int) -> None:
    with VirtualCameras(_clips(recording), rate, faults, seed) as cameras:
        pipe.send((cameras.addresses, cameras.begin))
        pipe.recv()


def _off(pose: LivePose, truth: Array, begin: float) -> float:
    """m, mean over the joints, from where they truly were in the pictures that were shown; truth (T, J, 3) of the
    clip's frames, of 30 Hz."""
    shown = int((pose.time - begin) * 30.0 + 0.05)
    return float(np.linalg.norm(pose.joints - truth[int(there_and_back(shown, len(truth)))], axis=-1).mean())


def _plain(row: Row) -> dict[str, Any]:
    return {k: v for k, v in vars(row).items() if v is not None}
