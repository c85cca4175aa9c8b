"""Depth cameras that see past the person whom another one sees, or measure nothing, are reported."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic.depth_frames import empty_rooms, seen_before
from hypose.calibration.diagnostics import Observed, examine
from hypose.calibration.findings import depth_findings, seen_past
from hypose.cameras.camera import CameraRig
from hypose.geometry import se3
from hypose.pipeline.input_checks import check_inputs
from hypose.pipeline.sources import FrameList
from hypose.synthetic.depth_scenes import depth_scene, to_profile, turning
from hypose.synthetic.motions import act
from hypose.synthetic.subjects import load_subjects

SUBJECTS = [subject for _, subject in sorted(load_subjects().items())]


def frames_of(sensors="depth-2", seed=24, count=5, others=False):
    """A few frames of somebody who walks before depth cameras; others: beside somebody else, who walks 0.9 m away."""
    subject, other = SUBJECTS[seed % len(SUBJECTS)], SUBJECTS[(seed + 3) % len(SUBJECTS)]
    p = act("walk", subject, 3.0, 25.0, np.random.default_rng(seed))
    scene = depth_scene(turning(p, subject, 0.7 * to_profile(len(p), seed)), subject, sensors, seed=seed)
    if others:
        q = act("walk", other, 3.0, 25.0, np.random.default_rng(seed + 100))
        scene = replace(scene, others=((other, replace(q, root=q.root + np.array([0.9, 0.2, 0]))),))
    rooms, out = empty_rooms(scene, 3), []
    for t in np.linspace(0, len(scene) - 1, count).round().astype(int).tolist():
        maps = [scene.depth_map(c, t) for c in range(len(scene.rig))]
        out.append(seen_before(rooms, maps, scene.rig, t / 25, t, people=others))
    return out


@pytest.fixture(scope="module")
def depths():
    return [f.depth for f in frames_of()]


def exchanged(rig):
    a, b = rig
    return CameraRig((replace(b, name=a.name), replace(a, name=b.name)))


def mirrored(depth, views):
    maps, person = depth.maps.copy(), depth.person.copy()
    for c in views:
        maps[c], person[c] = maps[c, :, ::-1], person[c, :, ::-1]
    return replace(depth, maps=maps, person=person)


def _of(frames, rig=None):
    """The evidence of frames, with their own cameras or others."""
    rig = rig or frames[0].depth.rig
    return Observed(
        rig, silhouettes=[f.silhouettes for f in frames], depths=[replace(f.depth, rig=rig) for f in frames]
    )


@pytest.mark.parametrize("sensors, others", [("depth-2", False), ("depth-3", False), ("depth-2", True)])
def test_of_right_cameras_nothing_is_said(sensors, others):
    found = [f.depth for f in frames_of(sensors, others=others)]
    assert depth_findings(found) == ()
    counted = np.array([seen_past(d) for d in found])
    assert counted[:, 0].min() > 100 and (counted[:, 1] / counted[:, 0]).max() < 0.25


def test_cameras_that_see_past_the_person_are_reported_once(depths):
    for wrong in ([replace(d, rig=exchanged(d.rig)) for d in depths], [mirrored(d, [1]) for d in depths]):
        (found,) = depth_findings(wrong)
        assert found.fault and found.kind == "places" and found.views == ("depth1", "depth2")


def test_one_camera_is_examined_by_its_floor():
    frames = frames_of("depth-1", count=2)
    rig = frames[0].depth.rig
    lower = se3(np.eye(3), np.array([0, 0, 0.9]))
    low = CameraRig((replace(rig[0], camera_from_world=rig[0].camera_from_world @ lower),))
    found = examine(_of(frames, low))[0].findings
    assert [f.kind for f in found] == ["floor"] and found[0].fault
    assert examine(_of(frames))[0].healthy


@pytest.mark.parametrize("often", [1.0, 0.8])
def test_a_camera_that_measures_nothing_is_named_and_a_fault_where_no_other_is_left(depths, often):
    def gone(k, depth, views):
        blank = np.zeros(2, bool)
        blank[views] = k >= len(depths) * (1 - often)
        return replace(depth, blank=blank, usable=depth.usable & ~blank)

    (found,) = depth_findings([gone(k, d, [1]) for k, d in enumerate(depths)])
    when = "in all frames" if often == 1 else "in 80 % of the frames"
    assert f"depth2 measures nothing {when}" in found.sentence and "[[view]]" in found.cure and not found.fault
    both = depth_findings([gone(k, d, [0, 1]) for k, d in enumerate(depths)])
    assert [f.views for f in both if f.kind == "blank"] == [("depth1",), ("depth2",)]
    assert all(f.fault == (often == 1) for f in both)


@pytest.mark.parametrize("lost, told", [(0.25, False), (0.5, True)])
def test_maps_that_are_riddled_with_holes_are_told_and_their_cameras_not_accused(lost, told):
    rng, frames = np.random.default_rng(0), frames_of()
    holes = [replace(f, depth=replace(f.depth, maps=f.depth.maps * (rng.random(f.depth.maps.shape) > lost)))
             for f in frames]  # fmt: skip
    found = check_inputs(FrameList(holes), "silhouettes")
    assert [(f.kind, f.views) for f in found] == ([("holes", ("depth1",)), ("holes", ("depth2",))] if told else [])
    assert all(f.fault and "holes all over its depth maps" in f.sentence for f in found)
