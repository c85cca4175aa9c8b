"""Depth cameras as the tracker's evidence: error, registration by the person, speed, and whether regions hold.

Everything is simulated: subjects of another shape space than the tracker's body, dressed, captured motion with turns to
both profiles, sensors with the faults of `hypose.synthetic.depth_scenes`. Settings were chosen on seeds 0 to 9; seeds
from 710 on are reported (700 and 701 showed that a box stood before a sensor, and count for nothing).
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from benchmarks.bench_report import BenchOptions, BenchReport, Row, row
from benchmarks.multiview.action_scenes import captured, subject_of_seed
from benchmarks.multiview.error_fit import auroc, ece
from benchmarks.synthetic.depth_frames import depth_frames, empty_rooms, seen_before
from benchmarks.synthetic.noisy_masks import LEVELS, corrupt_mask
from benchmarks.synthetic.retarget import retarget
from benchmarks.synthetic.sensors import SensorModel, simulate
from hypose.body.default_body import human
from hypose.body.motion import Motion
from hypose.calibration.depth_registration import place_error
from hypose.cameras.camera import CameraRig
from hypose.compute.parts import covered
from hypose.errors import EvidenceError, HyposeError
from hypose.evidence.depth_evidence import Depth, camera_on_floor
from hypose.evidence.frame import Frame
from hypose.evidence.silhouettes import make_silhouettes
from hypose.fusion import joints as jt
from hypose.fusion.fuse import common_positions, fuse_clip
from hypose.geometry import Array, se3, se3_inverse, so3_exp, transform
from hypose.pipeline.import_depth import register_depth
from hypose.pipeline.live.capture import CaptureOptions
from hypose.pipeline.live.engine import Listener, LiveEngine, LiveResult
from hypose.pipeline.live.live_people import LivePersonOptions
from hypose.pipeline.live.live_rig import live_rig
from hypose.pipeline.sources import FrameList
from hypose.pipeline.track import track_people, track_source
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.depth_scenes import DepthScene, depth_rig, depth_scene, to_profile, turning
from hypose.synthetic.metrics import EVALUATED, population_offsets, with_offsets
from hypose.synthetic.motions import act
from hypose.synthetic.performance import assemble
from hypose.synthetic.scenes import look_at
from hypose.synthetic.subjects import dress
from hypose.synthetic.write_recording import walking_scene, write_depth_scene
from hypose.tracking.error_model import WRONG_M
from hypose.tracking.recipes import recipe
from hypose.tracking.tracker import Tracker, TrackerSettings, motion_of

FRESH_SEED = 710
RATE = 25.0
_CAPTURES = (("walk", "02_01", 0.0), ("box", "02_05", 2.5), ("run", "02_03", 0.0))
SENSORS = {"one": "depth-1", "two": "depth-2", "three": "depth-3"}
_CLOCK = (5.0, 3)
"""s that the second sensor's clock is ahead, and frames by which it begins later"""
_COVERED, _TIMED = 0.9, 30
_MOVED, _MOVED_S = {"start": 0.0, "middle": 0.5}, 4.0
"""share of the frames before the second sensor moves, and s"""
_FEW = 3
"""seeds of which two sensors are brought together, and frames timed: the first takes as long as four of the others"""


def scene_of(seed: int, sensors: str, seconds: float, options: BenchOptions, action: int | None = None) -> DepthScene:
    """Walking, boxing or running, by the seed, or combo (action -1), while turning to both profiles."""
    subject = dress(subject_of_seed(seed), 0.02, np.random.default_rng([seed, 0]))
    name, clip, start = _CAPTURES[seed % 3]
    if action is None and captured(options):
        folder = options.folder("mocap")
        p = retarget(folder / "02.asf", folder / f"{clip}.amc", subject, RATE, start=start, seconds=seconds)
    else:
        built_in = "combo" if action is not None else {"run": "jog"}.get(name, name)
        p = act(built_in, subject, seconds, RATE, np.random.default_rng([seed, 1]))
    side = np.median(p.joints[:, 13] - p.joints[:, 16], axis=0)
    heading = to_profile(len(p), seed) - np.arctan2(side[1], side[0])
    return depth_scene(turning(p, subject, heading), subject, depth_rig(sensors), seed=seed)


def depth(options: BenchOptions) -> BenchReport:
    """mean_mm of 15 joints with one sensor in front, two at 90 degrees, three all round, and one beside a colour
    camera: the product as it is, body and start found in the clip, all frames solved together. sdk: skeletons that
    simulated sensors report of the same scenes, fused. registration_*: two sensors brought together by the person.
    coverage_90: share of true joints in their 90 % regions. wrong_auroc, wrong_ece: how well it is told which joints
    are wrong by more than 100 mm, and how likely. ms_per_frame, ms_mean: processor time of one sensor's frame, from the
    map to the pose, median and mean over a clip's frames: that of an instant over its sensors. together_mm, alone_mm,
    exchanged, invented: two people who walk past each other, 0.8 m apart, tracked together and each alone (no empty
    room: it was not recorded); share of the frames in which a track is not its person's; people beyond the two.
    place_deg, place_mm, moved_mm, told_mm: of two sensors the second is turned by 2 degrees and moved by 40 mm, at the
    start or in the middle of 4 s; how far off its place is at the end, mean_mm then, and as it is told. latency_*: from
    the later map's arrival to the pose, of two simulated sensors whose maps the live engine plays at their pace."""
    seeds = options.seed_range(10, first=FRESH_SEED, quick=1)
    seconds = 1.2 if options.quick else 2.0
    found: dict[tuple[str, str], list[float]] = {}

    def keep(metric: str, case: str, value: float) -> None:
        if np.isfinite(value):
            found.setdefault((metric, case), []).append(value)

    jobs = [(seed, case) for seed in seeds for case in (*SENSORS, "one+colour")]
    jobs += [(seed, what) for what in ("registration", "speed") for seed in seeds[:_FEW]]
    jobs += [(seed, f"moved/{when}") for seed, when in zip(seeds, _MOVED, strict=False)]
    jobs += [(seed, f"people/{case}") for seed, case in zip(seeds, SENSORS, strict=False)]
    jobs += [(seed, f"people/{case}, no empty room") for seed, case in zip(seeds, ("two", "three"), strict=False)]
    jobs.append((seeds[0], "live"))
    inside: dict[str, list[float]] = {}
    told: dict[str, list[tuple[NDArray[np.float64], NDArray[np.bool_]]]] = {}
    for n, (seed, case) in enumerate(jobs):
        options.progress(f"{case} seed {seed}", n, len(jobs))
        part = options.part(f"depth.{seed}.{case}", lambda s=seed, c=case: _measured(s, c, seconds, options))
        for name, value in part.items():
            if name in ("ms_per_frame", "ms_mean"):
                for sensors, ms in value.items():
                    keep(name, sensors, ms)
            elif name in ("colour_mm", "sdk_mm"):
                keep("mean_mm", "colour alone" if name == "colour_mm" else f"sdk/{case}", value)
            elif isinstance(value, float):
                keep(name, "two" if case in ("registration", "live") else case, value)
        if "error" in part:
            away = np.linalg.norm(np.asarray(part["error"]), axis=-1)
            told.setdefault(case, []).append((np.asarray(part["error_probability"]).ravel(), (away > WRONG_M).ravel()))
            inside.setdefault(case, []).append(float(_within(part).mean()))
    options.progress("done", len(jobs), len(jobs))
    rows: list[Row] = [row(metric, case, values, _unit(metric)) for (metric, case), values in found.items()]
    rows += [row("coverage_90", case, values, "1") for case, values in inside.items()]
    if inside:
        rows.append(row("coverage_90", "all", [np.mean(v) for v in zip(*inside.values(), strict=False)], "1"))
    for case, clips in told.items():  # clips together: in most of them nothing is wrong
        p, wrong = (np.concatenate(v) for v in zip(*clips, strict=True))
        rows += [row("wrong_auroc", case, [auroc(p, wrong)], "1")] if wrong.any() else []
        rows.append(row("wrong_ece", case, [ece(p, wrong)], "1"))
    settings = {"seeds": len(seeds), "first_seed": seeds.start, "seconds": seconds, "frame_rate": RATE}
    settings["motion"] = "captured" if captured(options) else "built-in"
    settings["sensors"] = "simulated"
    return BenchReport(tuple(rows), settings)


def _unit(metric: str) -> str:
    if metric.startswith("ms_"):
        return "ms"
    return {"mm": "mm", "ms": "ms", "deg": "degrees"}.get(metric.rpartition("_")[2], "1")


def _within(part: dict[str, Any]) -> NDArray[np.bool_]:
    """(T, J): is the true joint in its region?"""
    error, covariance = (np.asarray(part[k], dtype=np.float64) for k in ("error", "covariance"))
    squared = (error * np.linalg.solve(covariance, error[..., None])[..., 0]).sum(-1)
    return np.asarray(squared <= chi2.ppf(_COVERED, 3))


def _measured(seed: int, case: str, seconds: float, options: BenchOptions) -> dict[str, Any]:
    try:
        if case == "registration":
            return _registration(seed, options)
        if case == "speed":
            return _speed(seed, seconds, options)
        if case.startswith("people/"):
            sensors, _, unknown = case.removeprefix("people/").partition(", ")
            return people_apart(seed, SENSORS[sensors], seconds, empty=not unknown)
        if case.startswith("moved/"):
            scene = scene_of(seed, "depth-2", 1.6 if options.quick else _MOVED_S, options, action=-1)
            return moved_sensor(scene, _MOVED[case.removeprefix("moved/")], seed)
        if case == "live":
            return live_depth(seed, options.quick)
        if case == "one+colour":
            return _with_colour(seed, seconds, options)
        return _tracked(seed, case, seconds, options)
    except HyposeError as error:  # a clip that the product refuses is a miss, and not left out
        missed = {"mean_mm": 1000.0} if case in (*SENSORS, "one+colour") else {}
        return {"refused": str(error), **missed}


def _tracked(seed: int, case: str, seconds: float, options: BenchOptions) -> dict[str, Any]:
    scene = scene_of(seed, SENSORS[case], seconds, options)
    frames = list(depth_frames(scene))
    result = track_source(FrameList(frames, RATE), RATE, TrackOptions(seed=seed))
    out = _errors(result.motion, scene)
    if case != "one":
        out["sdk_mm"] = _sdk(scene, seed)
    return out


def _speed(seed: int, seconds: float, options: BenchOptions) -> dict[str, Any]:
    """Processor time of frames, by the sensors."""
    out: dict[str, Any] = {"ms_per_frame": {}, "ms_mean": {}}
    for case, sensors in SENSORS.items():
        scene = scene_of(seed, sensors, seconds, options)
        frames = list(depth_frames(scene))
        result = track_source(FrameList(frames, RATE), RATE, TrackOptions(seed=seed))
        tracker = Tracker(result.body, recipe("default", result.body, frame_rate=RATE), TrackerSettings(seed=seed))
        assert result.motion.poses is not None
        state = tracker.start(result.motion.poses[0])
        spent, rooms = [], empty_rooms(scene)
        for frame in frames[:_TIMED]:
            assert frame.depth is not None
            began = time.process_time()
            seen = seen_before(rooms, list(frame.depth.maps), scene.rig, frame.time, frame.index)
            state, _ = tracker.step(state, seen)
            spent.append(time.process_time() - began)
        each = 1e3 * np.array(spent) / len(scene.rig)
        out["ms_per_frame"][case], out["ms_mean"][case] = float(np.median(each)), float(each.mean())
    return out


def aligned(motion: Motion, scene: DepthScene) -> Array:
    """(T, J, 3) m: the joints of a motion as the truth defines them."""
    assert motion.poses is not None
    rotations, _ = motion.skeleton.forward(motion.poses)
    return with_offsets(motion.joints, rotations, population_offsets(human()) * scene.subject.stature)


def _errors(motion: Motion, scene: DepthScene) -> dict[str, Any]:
    error = (scene.joints[: len(motion)] - aligned(motion, scene))[:, EVALUATED]
    away = np.linalg.norm(error, axis=-1)
    return {
        "mean_mm": 1e3 * float(away.mean()),
        "p95_mm": 1e3 * float(np.percentile(away, 95)),
        "error": np.round(error, 5),
        "covariance": np.asarray(motion.joint_covariance, dtype=np.float64)[:, EVALUATED],
        "error_probability": [] if motion.error_probability is None else motion.error_probability[:, EVALUATED],
    }


def _sdk(scene: DepthScene, seed: int) -> float:
    """mm: what skeletons of simulated SDKs give when they are fused (case of the same sensors and motion)."""
    joints = scene.joints[:, jt.BODY_JOINT].copy()
    joints[:, jt.TORSO] = (
        joints[:, [jt.LEFT_SHOULDER, jt.RIGHT_SHOULDER]].mean(1) + joints[:, [jt.LEFT_HIP, jt.RIGHT_HIP]].mean(1)
    ) / 2
    side = joints[:, jt.LEFT_HIP] - joints[:, jt.RIGHT_HIP]
    heading = np.unwrap(np.arctan2(side[:, 1], side[:, 0]))
    cameras = np.stack([c.camera_from_world for c in scene.rig])
    rng = np.random.default_rng([seed, 9])
    recording = simulate(joints, heading, cameras, rng, SensorModel(), np.zeros((0, 7)))
    fused = fuse_clip(recording.frames(), "fit")
    away = np.linalg.norm(common_positions(fused.motion) - recording.truth_in(0), axis=-1)
    return 1e3 * float(np.nanmean(away))


def _with_colour(seed: int, seconds: float, options: BenchOptions) -> dict[str, Any]:
    """One depth camera in front and the silhouettes of a colour camera beside."""
    scene = scene_of(seed, "depth-1", seconds, options)
    side = look_at("colour", (3.6, 0.0, 1.4), (0, 0, 0.95), 600.0, (640, 480))
    rig = CameraRig((*scene.rig, side))
    what = LEVELS["level-1"]
    frames, p = [], scene.performance
    for frame in depth_frames(scene):
        vertices = scene.subject.skin(p.rotations[frame.index], p.root[frame.index])
        z = vertices @ side.camera_from_world[2, :3] + side.camera_from_world[2, 3]
        mask = covered(side.project_pinhole(vertices), z, scene.subject.faces, side.size[::-1]).astype(np.uint8)
        rng = np.random.default_rng([seed, 8, frame.index])
        mask = corrupt_mask(mask, np.zeros_like(mask), what, rng)
        assert frame.depth is not None
        w, h = scene.rig[0].size
        silhouettes = make_silhouettes([frame.depth.person[0], mask], rig)
        maps = np.zeros(silhouettes.masks.shape, np.float32)
        maps[0, :h, :w] = frame.depth.maps[0]
        person = silhouettes.masks.copy()
        person[1] = 0
        both = Depth(maps, person, rig, np.array([True, False]))
        frames.append(Frame(frame.time, frame.index, silhouettes, depth=both))
    result = track_source(FrameList(frames, RATE), RATE, TrackOptions(seed=seed))
    out = _errors(result.motion, scene)
    # the colour camera alone, though with the body and the first pose that only both together found
    assert result.motion.poses is not None
    alone = []
    for frame in frames:
        assert frame.silhouettes is not None
        own = make_silhouettes([frame.silhouettes.masks[1, :480, :640]], CameraRig((side,)))
        alone.append(Frame(frame.time, frame.index, own))
    tracker = Tracker(result.body, recipe("default", result.body, frame_rate=RATE), TrackerSettings(seed=seed))
    found = [e for _, e in tracker.follow(tracker.start(result.motion.poses[0]), alone)]
    colour = motion_of(result.body, scene.times, found)
    out["colour_mm"] = _errors(colour, scene)["mean_mm"]
    return out


def _registration(seed: int, options: BenchOptions) -> dict[str, Any]:
    """Two sensors at 90 degrees, each in a world that it knows by its own floor, the second one late and by another
    clock."""
    scene = scene_of(seed, "depth-2", 1.6 if options.quick else 3.0, options, action=-1)
    frames = list(depth_frames(scene))
    worlds, clips = [], []
    ahead, late = _CLOCK
    for c, camera in enumerate(scene.rig):
        alone = replace(camera, camera_from_world=np.eye(4))
        on_floor = camera_on_floor(scene.empty_map(c, 0), alone)
        rig = CameraRig((replace(alone, camera_from_world=on_floor),))
        worlds.append(on_floor)
        clip = []
        for k, frame in enumerate(frames[late if c else 0 :]):
            assert frame.depth is not None
            own = make_silhouettes([frame.depth.person[c]], rig)
            seen = Depth(frame.depth.maps[c][None], own.masks, rig, own.usable)
            clip.append(Frame(k / RATE + (ahead if c else 0.0), k, own, depth=seen))
        clips.append(clip)
    found = register_depth(clips, RATE, seed=seed)
    own_from_world = se3_inverse(worlds[0]) @ scene.rig[0].camera_from_world
    true = scene.rig[1].camera_from_world @ se3_inverse(own_from_world)
    at = transform(own_from_world, np.array([[0.0, 0.0, 1.0]]))[0]
    degrees, metres = place_error(found.rig[1].camera_from_world, true, at)
    clock = float(found.seconds[1]) - (late / RATE - ahead)
    return {"registration_deg": degrees, "registration_mm": 1e3 * metres, "clock_ms": 1e3 * abs(clock)}


_TURN_DEGREES, _STEP_M = 2.0, (0.04, 0.0, 0.0)


def knocked(scene: DepthScene) -> DepthScene:
    """The scene before a second camera that is turned about the vertical and stands a step beside."""
    camera = scene.rig[1]
    turn = se3(so3_exp(np.radians([0, 0, _TURN_DEGREES])), np.zeros(3))
    here, there = (se3(np.eye(3), p) for p in (-camera.position, camera.position + np.array(_STEP_M)))
    moved = replace(camera, camera_from_world=camera.camera_from_world @ np.linalg.inv(there @ turn @ here))
    return replace(scene, rig=CameraRig((scene.rig[0], moved, *list(scene.rig)[2:])))


def moved_sensor(scene: DepthScene, share: float, seed: int) -> dict[str, Any]:
    """place_deg, place_mm: how far off the second camera's place is at the end; moved_mm, told_mm: mean error with its
    place found again, and with the given one. share: of the frames before it is knocked. What it sees is cut from the
    empty room as it sees that from where it stands."""
    other, frames = knocked(scene), list(depth_frames(scene))
    change = round(share * len(frames))
    frames[change:] = [_as_told(f, scene.rig) for f in list(depth_frames(other))[change:]]
    source, options = FrameList(frames, RATE), TrackOptions(seed=seed)
    found = track_source(source, RATE, options)
    now = found.places[-1].camera_from_world[1] if found.places else scene.rig[1].camera_from_world
    at = scene.joints[-1].mean(0)
    degrees, metres = place_error(now, other.rig[1].camera_from_world, at)
    told = track_source(source, RATE, options, find_places=False)
    out = {"place_deg": degrees, "place_mm": 1e3 * metres, "moved_mm": 1e3 * float(_away(found.motion, scene).mean())}
    return out | {"told_mm": 1e3 * float(_away(told.motion, scene).mean())}


def _as_told(frame: Frame, rig: CameraRig) -> Frame:
    assert frame.silhouettes is not None and frame.depth is not None
    told = replace(frame.silhouettes, rig=rig)
    return replace(frame, silhouettes=told, depth=replace(frame.depth, rig=rig))


_SPEED, _ASIDE_M = 1.1, 0.4
"""m/s, and m beside the middle on which each of them walks"""
_LOST_M = 0.25
"""m: mean error of a frame in which a track is somebody else's, or nobody's"""


def passing(seed: int, sensors: str, seconds: float, rate: float) -> list[DepthScene]:
    """Two scenes of the same instants: somebody alone who walks along x, and somebody who comes towards them."""
    scenes = []
    for k, way in enumerate((1.0, -1.0)):
        subject = dress(subject_of_seed(seed + 1000 * k), 0.02, np.random.default_rng([seed, k]))
        p = act("walk", subject, seconds, rate, np.random.default_rng([seed, 5 + k]))
        p = turning(p, subject, np.full(len(p), way * np.pi / 2))
        at = p.root * [0, 0, 1] + [0, -_ASIDE_M * way, 0]
        at[:, 0] += way * _SPEED * (p.times - p.times.mean())
        scenes.append(depth_scene(assemble(p.name, subject, p.times, p.rotations, at), subject, sensors, seed=seed))
    return scenes


def people_apart(seed: int, sensors: str, seconds: float, empty: bool = True) -> dict[str, float]:
    """together_mm, alone_mm: mean error of both when they are tracked together, and each alone; exchanged: share of
    the frames in which a track is not its person's; invented: people beyond the two. empty: the empty room was
    recorded."""
    alone = passing(seed, sensors, seconds, RATE)
    first, second = alone
    both = replace(first, others=((second.subject, second.performance),))
    options = TrackOptions(seed=seed)
    found = track_people(FrameList(list(depth_frames(both, True, empty)), RATE), RATE, options).people
    out = {"invented": float(max(len(found) - 2, 0)), "together_mm": 1000.0, "exchanged": 1.0}
    errors = np.array([[_away(p.motion, s) for p in found] for s in alone])
    if len(found) >= 2:
        mine = errors.mean(-1).argmin(1)
        own = errors[[0, 1], mine]
        if mine[0] != mine[1]:
            out |= {"together_mm": 1e3 * float(own.mean()), "exchanged": float((own > _LOST_M).mean())}
    by_themselves = [
        track_source(FrameList(list(depth_frames(s, empty=empty)), RATE), RATE, options).motion for s in alone
    ]
    out["alone_mm"] = 1e3 * float(np.mean([_away(m, s) for m, s in zip(by_themselves, alone, strict=True)]))
    return out


def _away(motion: Motion, scene: DepthScene) -> Array:
    """(T,) m: mean error of each frame."""
    return np.linalg.norm(scene.joints - aligned(motion, scene), axis=-1)[:, EVALUATED].mean(1)


class _Late(Listener):
    """A listener that notes how late each pose is, s."""

    def __init__(self) -> None:
        self.late: list[float] = []

    def seen(self, seen: LiveResult) -> None:
        """See `Listener`."""
        if seen.poses:
            self.late.append(time.monotonic() - seen.captured.arrival)


def live_depth(seed: int, quick: bool) -> dict[str, Any]:
    """latency_p50_ms, latency_p99_ms of somebody who walks; an EvidenceError when nobody was found."""
    seconds = 15.0 if quick else 40.0
    scene = walking_scene("walk", "", "depth-2", seconds=seconds, frame_rate=RATE, seed=seed)
    listener = _Late()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "depth"
        write_depth_scene(scene, folder)
        found = live_rig(folder, {})
        person = LivePersonOptions(TrackOptions(seed=seed), None, None)
        capture = CaptureOptions(found.rate, 0.0, found.silhouettes)
        engine = LiveEngine(found.rig, found.views, capture, person, listeners=[listener])
        try:
            engine.start()
            engine.ended.wait(seconds + 10)
        finally:
            engine.stop()
    if engine.failed is not None:
        raise engine.failed
    if len(listener.late) < 2 * RATE:
        raise EvidenceError("Nobody was followed long enough to tell how late poses are.")
    p50, p99 = np.percentile(listener.late, [50, 99]) * 1e3
    return {"latency_p50_ms": float(p50), "latency_p99_ms": float(p99)}
