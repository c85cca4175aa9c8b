"""Fuse recorded skeletons of several sensors to one motion per person, and write its files."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from hypose.app.commands.console import (
    ProgressCall,
    Stages,
    counted,
    ignore,
    print_note,
    print_notes,
    say,
    stopping,
)
from hypose.app.jobs.job import ASSESSMENT_FILE, print_assessments, print_figures, split_names
from hypose.app.live.live_server import LiveServer, run_live
from hypose.app.options import FuseCommand
from hypose.app.reports.report_parts import require_found, write_csv
from hypose.body.body import Body
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.evidence.frame import SensorJoints
from hypose.fusion.align import AlignSettings, Instant, SensorBody, SensorView, offset_by_movement
from hypose.fusion.fuse import Fused, fuse_clip
from hypose.fusion.joints import COMMON, joint_set
from hypose.fusion.people import PeopleTracker
from hypose.fusion.register import Registration, check_same_person, common_joints, register, upright_axes, upward
from hypose.geometry import Array, se3, transform
from hypose.io.files import check_writable, claimed, file_name
from hypose.io.motions.export import export_motion
from hypose.io.motions.results import provenance, results_folder, save_motion, to_json, write_json
from hypose.io.sensors.skeleton_files import (
    SensorStream,
    SkeletonRecording,
    common_times,
    join_observations,
    read_skeletons,
    resample,
    shifted,
)
from hypose.pipeline.assessment import Assessment
from hypose.pipeline.sensor_skeletons import assess_fused

POINT_FORMATS = ("trc", "c3d", "csv")
"""Formats of motion files that need no poses."""
_FOOT_HEIGHT_M = 0.08  # of the ankle, which stands for the foot, above the floor


def fuse(c: FuseCommand) -> None:
    """Fuse skeletons of sensors: live or from a recording (`hypose fuse`)."""
    if c.live:
        if c.recording is not None:
            raise InputError("--live takes no recording; leave one of the two out.")
        ports = {} if c.udp is None and c.ws is None else {"udp": c.udp, "ws": c.ws}
        settings = AlignSettings(rate=30.0 if c.rate is None else c.rate, wait=c.wait / 1000)
        about = {"osc": c.osc, "token": c.token, "record": c.record, "settings": settings, "note": print_note}
        asyncio.run(run_live(LiveServer(host=c.host, **ports, **about), say, print_note))
        return
    if c.recording is None:
        raise InputError("There is nothing to fuse; give a recording of skeletons, or --live.")
    loaded = read_skeletons(c.recording)
    folder = c.recording if c.recording.is_dir() else c.recording.parent
    name = f"fuse-{c.method}" if c.recording.is_dir() else f"{file_name(loaded.name)}-fuse-{c.method}"
    results = results_folder(folder, name) if c.out is None else c.out
    kept = f"Stopped; motions that were complete are kept in {results}. Start again with the same command."
    with stopping(kept), claimed(results), Stages() as progress:
        people, notes = run_fuse(loaded, results, c, progress)
    print_notes(notes)
    for n, (m, _) in enumerate(people, 1):
        name = f"{loaded.name}{f', person {n}' if len(people) > 1 else ''}"
        print_figures(name, m, f"of {counted(len(loaded.streams), 'sensor')} at {m.frame_rate:g} Hz")
    say(f"Results: {results}")
    if all(m.lost.all() for m, _ in people):
        require_found(people[0][0], loaded.name, results)
    print_assessments({f"person-{n}" if len(people) > 1 else "": a for n, (_, a) in enumerate(people, 1)})


def run_fuse(
    recording: SkeletonRecording, results: Path, c: FuseCommand, progress: ProgressCall = ignore
) -> tuple[list[tuple[Motion, Assessment]], list[str]]:
    """Fuse the skeletons of a recording to one motion per person, and write the files of each.

    Each person's files are written before the next one is fused, and are kept after Ctrl-C.
    recording: skeletons of all sensors.
    results: folder for one person; with several, a folder person-1, person-2, ... in it for each.
    c: options of the user.
    Returns: motion, in a world with z up, and assessment of each person, in the order of appearance; and notes for the
        user.
    Raises: InputError names the input that cannot be used.
    """
    formats = split_names(c.formats)
    posed = [name for name in formats if name not in POINT_FORMATS]
    if posed:
        raise InputError(
            f"The format {posed[0]} needs poses, fused skeletons are points; choose {', '.join(POINT_FORMATS)}."
        )
    check_writable(results)
    notes = list(recording.notes)
    progress("prepare", 0, 1)
    streams = _ordered(recording, c)
    if not recording.common_clock:
        streams = _on_one_clock(streams, notes)
    times = common_times(streams, c.rate)
    people = _people([resample(s, times) for s in streams], times, notes)
    progress("prepare", 1, 1)
    names = [s.name for s in streams]
    registration = _registration(people, names)
    for name, residual, known in zip(names, registration.residual, registration.registered, strict=True):
        if not known:
            notes.append(f"{name}: it shares too little with the other sensors to be registered, so it is not used")
        elif residual > 0:
            notes.append(f"{name}: joints {1000 * residual:.0f} mm (median) from the reference sensor's")
    total, folders = len(people) * len(times), [results]
    if len(people) > 1:
        folders = [results / f"person-{n + 1}" for n in range(len(people))]
    done: list[tuple[Motion, Assessment]] = []
    world: Array | None = None
    for n, whole in enumerate(people):
        seen = np.flatnonzero([np.isfinite(f.times).any() for f in whole])
        span = slice(int(seen[0]), int(seen[-1]) + 1) if len(seen) else slice(None)
        clip = whole[span]
        watch = partial(lambda before, frames: progress("fuse", before + frames, total), n * len(times))
        made = fuse_clip(clip, c.method, registration, seed=c.seed, watch=watch)
        # instants at which no sensor saw the person have no measured time
        made = replace(made, motion=replace(made.motion, times=times[span]))
        if world is None:
            world = world_from_sensor(made.motion, c.up)
        assessment = assess_fused(made.motion, clip, registration, names)
        done.append((_write(recording, c, made, world, folders[n], notes, assessment), assessment))
        # only formats with poses use the body, and those were refused above
        export_motion(done[-1][0], cast(Body, None), folders[n], formats)
    progress("fuse", total, total)
    return done, notes


# ---- streams -------------------------------------------------------------------------------------------------


def _ordered(recording: SkeletonRecording, c: FuseCommand) -> list[SensorStream]:
    """Put the reference sensor first, and convert to the common joints where the sensors report different sets.

    Raises: InputError for a sensor that the recording does not have, or a set of joints that is not known.
    """
    first = recording.stream(c.reference or recording.reference)
    streams = [first, *(s for s in recording.streams if s is not first)]
    for s in streams:
        joint_set(s.joint_names)  # an InputError for an unknown set, which must name the sensor's file
    if all(s.joint_names == first.joint_names for s in streams):
        return streams
    out = []
    for s in streams:
        pick = joint_set(s.joint_names).common
        depth = None if s.joint_depth is None else s.joint_depth[:, :, pick]
        picked = {"positions": s.positions[:, :, pick], "state": s.state[:, :, pick], "joint_depth": depth}
        out.append(replace(s, joint_names=COMMON, **picked))
    return out


def _on_one_clock(streams: Sequence[SensorStream], notes: list[str]) -> list[SensorStream]:
    """Shift the sensors' clocks so that all see the same movement as the first.

    notes: receives a sentence per sensor.
    Raises: InputError where the movements of two sensors differ.
    """
    first = streams[0]
    out = [first]
    for s in streams[1:]:
        begin = shifted(s, first.times[0] - s.times[0])
        offset, likeness = offset_by_movement(first.times, first.positions[:, 0], begin.times, begin.positions[:, 0])
        if likeness < 0.5:
            raise InputError(
                f"The clocks of the sensors {first.name} and {s.name} cannot be brought together, because their "
                f'movements differ (correlation {likeness:.2f}); give recordings of one person, or "clock": "common".'
            )
        notes.append(f"{s.name}: its clock was set by the movement (correlation {likeness:.2f})")
        out.append(shifted(begin, offset))
    return out


def _people(synced: Sequence[SensorStream], times: Array, notes: list[str]) -> list[list[SensorJoints]]:
    """Match the persons of all sensors.

    synced: streams of all sensors at the same times.
    times: (T,) s.
    notes: receives a sentence on persons that are left out.
    Returns: one clip (T instants) per person, in the order of appearance.
    Raises: InputError where no person is seen long enough.
    """
    if all(s.positions.shape[1] == 1 for s in synced):
        return [join_observations(synced, times, [np.where(s.person_ids[:, 0] >= 0, 0, -1) for s in synced])]
    picks = [joint_set(s.joint_names).common for s in synced]
    instants = [_instant(synced, picks, n, float(t)) for n, t in enumerate(times)]
    tracker = PeopleTracker()
    for instant in instants:
        tracker.update(instant)
    # match again from the start with the known places of the sensors
    tracker = PeopleTracker(transforms=tracker.transforms)
    columns: dict[int, list[NDArray[np.int64]]] = {}
    for n, instant in enumerate(instants):
        for person in tracker.update(instant):
            held = columns.setdefault(person.id, [np.full(len(times), -1) for _ in synced])
            for k, s in enumerate(synced):
                if s.name in person.bodies:
                    held[k][n] = person.bodies[s.name].person
    seen = {i: int((np.stack(c) >= 0).any(0).sum()) for i, c in columns.items()}
    least = max(10, round(0.02 * len(times)))
    kept = [columns[i] for i in columns if seen[i] >= least]
    if not kept:
        raise InputError("No person is seen long enough by any sensor to be followed; check the recording.")
    if dropped := len(columns) - len(kept):
        notes.append(f"{dropped} persons were seen for less than {least} frames and are left out")
    return [join_observations(synced, times, c) for c in kept]


def _instant(synced: Sequence[SensorStream], picks: Sequence[NDArray[np.int64]], n: int, time: float) -> Instant:
    """Collect what all sensors see at one time; persons are numbered by their columns in the streams.

    picks: indices of the common joints, per sensor.
    n: number of the instant.
    time: s.
    """
    views = []
    for s, pick in zip(synced, picks, strict=True):
        columns = np.flatnonzero((s.person_ids[n] >= 0) & (s.state[n] > 0).any(1))
        bodies = tuple(SensorBody(int(c), s.positions[n, c, pick], s.state[n, c, pick]) for c in columns)
        views.append(SensorView(s.name, True, 0, bodies))
    return Instant(n, time, tuple(views))


def _registration(people: Sequence[Sequence[SensorJoints]], names: Sequence[str]) -> Registration:
    """Register the sensors from all persons together, so that all share one frame of reference.

    people: one clip per person.
    names: names of the sensors.
    Raises: InputError where no joint is seen, or the sensors do not see the same person.
    """
    clips = [[common_joints(f) for f in clip] for clip in people]
    positions = np.concatenate([np.stack([f.positions for f in clip]) for clip in clips])
    states = np.concatenate([np.stack([f.state for f in clip]) for clip in clips])
    if not np.isfinite(positions).any():
        raise InputError("No sensor reports any joint in the whole recording; check that a person was tracked.")
    found = register(positions, states)
    check_same_person(positions, found, names)
    return found


# ---- fusion and files ------------------------------------------------------------------------------------------


def world_from_sensor(motion: Motion, up: str) -> Array:
    """Compute the transform (4, 4) from the reference sensor to the world: z up, y away from the sensor, origin below
    the sensor, and the floor at z = 0 by the lowest feet (2 % of the frames).

    up: "sensor": the sensor's own vertical; else the person's.
    """
    joints = motion.joints[:, [motion.skeleton.joint(n) for n in COMMON]]
    person = upward(joints[~motion.lost] if (~motion.lost).any() else joints)
    z = np.array([0.0, np.sign(person[1]) or -1.0, 0.0]) if up == "sensor" else person
    feet = joints[:, [COMMON.index("left_foot"), COMMON.index("right_foot")]] @ z
    feet = feet[np.isfinite(feet)]
    floor = float(np.percentile(feet, 2)) - _FOOT_HEIGHT_M if len(feet) else 0.0
    return se3(upright_axes(z), np.array([0.0, 0.0, -floor]))


def _write(
    recording: SkeletonRecording,
    c: FuseCommand,
    fused: Fused,
    world: Array,
    folder: Path,
    notes: Sequence[str],
    assessment: Assessment,
) -> Motion:
    """Write motion, provenance, assessment and sensors.csv of one person; return the motion in the world.

    fused: motion in the frame of the reference sensor.
    world: (4, 4) transform from the reference sensor to the world.
    notes: for the provenance.
    """
    settings = {
        "method": c.method,
        "rate": fused.motion.frame_rate,
        "reference": fused.sensor_names[0],
        "sensors": list(fused.sensor_names),
        "up": c.up,
        "world_from_reference": world,
        "reference_from_sensor": fused.registration.common_from_sensor,
        "notes": list(notes),
    }
    record = provenance(f"fusion-{c.method}", c.seed, settings, recording.inputs, {"threads": c.threads})
    motion = replace(fused.motion, joints=transform(world, fused.motion.joints), provenance=json.loads(to_json(record)))
    save_motion(motion, folder / "motion.npz")
    write_json(folder / "provenance.json", record)
    write_json(folder / ASSESSMENT_FILE, assessment.document())
    # each sensor's share (0 to 1) in each joint
    columns = ["time", *(f"{j}:{s}" for j in COMMON for s in fused.sensor_names)]
    table = np.column_stack([fused.motion.times, fused.shares.reshape(len(fused.shares), -1)])
    write_csv(folder / "sensors.csv", columns, table.round(4).tolist())
    return motion
