"""Live fusion without sockets: clocks, late, dead and returning sensors, several persons."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.depth_sensors.replay import replay
from hypose.errors import InputError
from hypose.evidence.frame import SensorReport
from hypose.fusion.align import Aligner, AlignSettings, SensorClock, offset_by_movement
from hypose.fusion.joints import COMMON, MIRROR
from hypose.fusion.people import LiveFuser, PeopleTracker
from hypose.geometry import se3_inverse, transform
from tests.depth_sensors import camera, places, reports, walker


def run(rng, seconds, **kwargs):
    fuser = LiveFuser()
    frames = replay(fuser, reports(rng, seconds, **kwargs))
    return fuser, [f for f, _ in frames], np.array([latency for _, latency in frames])


def errors(fuser, frames, angles=(0, 60, -60), people=1):
    """Mean joint distance (m) of every fused person to the nearest true one, in the frame of the first sensor."""
    anchor = next(n for n, m in fuser.people.transforms.items() if np.allclose(m, np.eye(4)))
    world_from_common = se3_inverse(camera(angles[int(anchor[1:])]))
    out = []
    for f in frames:
        true = np.stack([walker(f.time, places(people)[p], 1.3 * p) for p in range(people)])
        for p in f.people:
            joints = transform(world_from_common, p.joints)
            out.append(np.linalg.norm(true - joints, axis=-1).mean(1).min())
    return np.array(out)


# ---- clocks ----


def test_the_offset_is_that_of_the_quickest_message(rng):
    clock = SensorClock()
    for n in range(300):
        host = clock.update(n / 30, 500 + n / 30 + 0.001 + rng.exponential(0.004))
        assert host is not None and host <= 500 + n / 30 + 0.06
    assert clock.offset == pytest.approx(500.001, abs=5e-4)
    assert clock.jumps == 0


@pytest.mark.parametrize("jump", [-3600.0, -1.0, 5.0])
def test_a_clock_that_jumps_is_believed_after_three_messages(jump):
    clock = SensorClock()
    refused = []
    for n in range(60):
        t = n / 30
        refused.append(clock.update(t + (jump if n >= 30 else 0), t) is None)
    assert clock.jumps == 1
    assert np.flatnonzero(refused).tolist() == [30, 31]
    assert clock.offset == pytest.approx(-jump)


def test_clocks_of_recordings_are_brought_together_by_the_movement(rng):
    t = np.arange(600) / 30
    here = np.stack([walker(x) for x in t]) + 0.005 * rng.normal(size=(600, 15, 3))
    other = np.arange(400) / 25 + 0.013
    there = transform(camera(60), np.stack([walker(x + 2.34) for x in other]))
    there += 0.005 * rng.normal(size=there.shape)
    offset, likeness = offset_by_movement(t, here, other, there)
    assert offset == pytest.approx(2.34, abs=0.01)
    assert likeness > 0.8


# ---- output at a steady rate ----


def test_a_sensor_killed_and_restarted_costs_no_frame(rng):
    # its clock starts anew at zero, as that of a restarted program does
    epochs = {1: [(0.0, 777.0), (4.0, -4.0)]}
    fuser, frames, latency = run(rng, 8, silent=[(1, 2.0, 4.0)], epochs=epochs)
    assert [f.index for f in frames] == list(range(len(frames)))
    assert len(frames) >= 238 and np.diff([f.time for f in frames]) == pytest.approx(1 / 30)
    assert latency.max() <= fuser.aligner.settings.wait + 1e-6
    assert all(len(f.people) == 1 and f.people[0].id == 1 for f in frames[15:])
    carried = {f.index for f in frames for p in f.people if "s1" in p.sensors}
    assert not carried & set(range(80, 118))
    assert set(range(135, 235)) <= carried
    assert errors(fuser, frames[30:]).max() < 0.08


def test_all_sensors_dead_and_back(rng):
    silent = [(k, 2.0, 4.0) for k in range(3)]
    fuser, frames, _ = run(rng, 7, silent=silent)
    assert [f.index for f in frames] == list(range(len(frames)))
    assert not any(f.people for f in frames if 2.6 < f.time < 3.9)
    assert len(frames[-1].people) == 1 and len(frames[-1].people[0].sensors) == 3
    assert errors(fuser, frames[-30:]).mean() < 0.04


def test_a_sensor_that_comes_back_elsewhere_is_registered_anew(rng):
    before = [r for r in reports(rng, 10) if r.sensor != "s1" or r.arrival < 3]
    moved = [r for r in reports(rng, 10, angles=(0, -100, -60)) if r.sensor == "s1" and r.arrival > 5]
    fuser = LiveFuser()
    frames = [f for f, _ in replay(fuser, sorted(before + moved, key=lambda r: r.arrival))]
    assert all(len(f.people) == 1 for f in frames[15:])
    assert "s1" in frames[-1].people[0].sensors
    anchor = {"s0": 0, "s1": 60, "s2": -60}[frames[-1].sensors[0]]
    expected = transform(camera(anchor), se3_inverse(camera(-100))[None, :3, 3])[0]
    assert np.linalg.norm(fuser.people.transforms["s1"][:3, 3] - expected) < 0.1
    assert errors(fuser, frames[30:]).max() < 0.1


# ---- a machine that is busy with other things ----


def held_up(made, begin, end, sensors=("s0", "s1", "s2"), room=10**6):
    """Nothing of these sensors is read from begin to end; then their lines come 0.2 ms apart, as many as the socket's
    buffer has room for."""
    out, free, kept = [], end, 0
    for r in made:
        at = r.arrival
        if r.sensor in sensors and begin <= at < end:
            kept += 1
            if kept > room:
                continue
        if r.sensor in sensors and begin <= at:
            at = free = max(at, free + 2e-4)
        out.append(replace(r, arrival=at))
    return sorted(out, key=lambda r: r.arrival)


def serve(made, pause=(0.0, 0.0)):
    """As `replay`, but no timer runs in the pause."""
    fuser, frames = LiveFuser(AlignSettings(max_behind=30.0)), []
    for r in made:
        while (due := fuser.aligner.due()) < r.arrival:
            at = pause[1] if pause[0] <= due < pause[1] else due + 1e-9
            if at >= r.arrival:
                break
            frames += fuser.poll(at)
        fuser.push(r)
        frames += fuser.poll(r.arrival)
    return fuser, frames


ALL = ("s0", "s1", "s2")


@pytest.mark.parametrize(
    ("late", "length", "paused", "room"),
    [
        *((ALL, length, True, room) for length in (0.8, 1.6) for room in (10**6, 100)),
        *((late, length, False, 10**6) for late, length in ((("s0",), 0.8), (("s1",), 0.8), (ALL, 1.6))),
    ],
)
def test_a_pause_of_the_machine_or_lines_that_come_all_at_once_make_nobody_new(rng, late, length, paused, room):
    pause = (1.2, 1.2 + length)
    made = held_up(reports(rng, 2.5 + length, people=6), *pause, late, room=room)
    fuser, frames = serve(made, pause) if paused else serve(made)
    assert [f.index for f in frames] == list(range(len(frames)))
    assert {p.id for f in frames for p in f.people} == set(range(1, 7))
    assert len(frames[-1].people) == 6 and all(len(p.sensors) == 3 for p in frames[-1].people)
    assert errors(fuser, frames[-10:], people=6).max() < 0.06
    if room > 100:  # all was read in the end: no sensor was ever away
        assert [s["returns"] for s in fuser.aligner.status(pause[1] if paused else 3.0)] == [0, 0, 0]


# ---- persons ----


def test_six_persons_keep_their_numbers(rng):
    angles = (0, 50, -50, 100)
    fuser, frames, latency = run(rng, 6, angles=angles, people=6)
    assert [f.index for f in frames] == list(range(len(frames)))
    late = frames[40:]
    assert all(len(f.people) == 6 for f in late)
    assert {p.id for f in late for p in f.people} == {p.id for p in late[0].people}
    assert np.mean([len(p.sensors) for f in late for p in f.people]) > 3.9
    assert errors(fuser, late, angles, 6).mean() < 0.03
    # one number, one person: its place never jumps
    for i in {p.id for p in late[0].people}:
        trunk = np.stack([p.joints[8] for f in late for p in f.people if p.id == i])
        assert np.linalg.norm(np.diff(trunk, axis=0), axis=1).max() < 0.15


def test_a_sensor_that_takes_the_back_for_the_front_is_placed_right(rng):
    out = []
    for r in reports(rng, 6, angles=(0, 150)):
        out.append(replace(r, positions=r.positions[MIRROR]) if r.sensor == "s1" else r)
    fuser = LiveFuser()
    frames = [f for f, _ in replay(fuser, out)]
    between = fuser.people.transforms
    found = (se3_inverse(between["s0"]) @ between["s1"])[:3, 3]
    expected = transform(camera(0), se3_inverse(camera(150))[None, :3, 3])[0]
    assert np.linalg.norm(found - expected) < 0.15
    assert errors(fuser, frames[30:], (0, 150)).mean() < 0.04


def test_known_places_are_kept(rng):
    known = {f"s{k}": transform_between(camera(0), camera(a)) for k, a in enumerate((0, 60, -60))}
    tracker, aligner = PeopleTracker(transforms=known), Aligner()
    seen = []
    for r in reports(rng, 2):
        aligner.push(r)
        for instant in aligner.poll(r.arrival):
            seen.append(tracker.update(instant))
    assert all(len(people[0].bodies) == 3 for people in seen[5:])
    for name, motion in known.items():
        np.testing.assert_array_equal(tracker.transforms[name], motion)


def transform_between(a, b):
    return a @ se3_inverse(b)


# ---- bad reports ----


def push(aligner, time=0.0, names=COMMON, positions=None, state=None, sensor="a", person=0, now=None):
    joints = transform(camera(0), walker(time)) if positions is None else positions
    level = np.full(len(joints), 2, dtype=np.uint8) if state is None else state
    return aligner.push(SensorReport(sensor, time, person, tuple(names), joints, level, now))


@pytest.mark.parametrize(
    ("report", "message"),
    [
        ({"names": ("head", "tail"), "positions": np.zeros((2, 3))}, "none of the known sets"),
        ({"positions": 1000 * walker(0.0)}, "divide millimetres"),
        ({"time": np.nan, "positions": walker(0.0)}, "times are seconds"),
        ({"positions": walker(0.0)[:14]}, "15 joints but gives 14"),
    ],
)
def test_reports_that_cannot_be_used_are_refused_in_a_sentence(report, message):
    with pytest.raises(InputError, match=message):
        push(Aligner(), **report)


def test_sensors_and_persons_beyond_the_most_are_refused():
    aligner = Aligner(AlignSettings(most_sensors=2, most_people=2))
    push(aligner, sensor="a"), push(aligner, sensor="a", person=1), push(aligner, sensor="b")
    with pytest.raises(InputError, match="2 sensors already"):
        push(aligner, sensor="c")
    with pytest.raises(InputError, match="more than 2 persons"):
        push(aligner, sensor="a", person=2)
    push(aligner, time=100.0, sensor="c")  # the dead make room
    with pytest.raises(InputError, match="1 to 1000"):
        AlignSettings(rate=0)


def test_late_reports_are_sorted_in_and_doubled_ones_are_ignored():
    aligner = Aligner()
    assert push(aligner, 0.0, now=0.0) and push(aligner, 2 / 30, now=2 / 30)
    assert push(aligner, 1 / 30, now=2.1 / 30)
    assert not push(aligner, 1 / 30, now=2.2 / 30)
    at = aligner.poll(2.2 / 30)
    np.testing.assert_allclose(at[1].sensors[0].bodies[0].positions, transform(camera(0), walker(1 / 30)), atol=1e-3)
