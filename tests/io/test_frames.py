"""The frame stream on a small film of four views, and on the real recordings when they are there."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from benchmarks.multiview.real_recordings import balancing_recording, uu4cam_recording
from hypose.cameras.camera import CameraRig
from hypose.errors import InputError
from hypose.evidence.colours import colour_codes
from hypose.evidence.keypoints import BODY_25B, triangulate_keypoints
from hypose.evidence.silhouettes import biggest_parts
from hypose.io.recordings.frames import (
    FrameSettings,
    FrameStream,
    working_rig,
    write_masks,
)
from hypose.io.recordings.recording import Recording, ViewSettings, load_recording, write_recording
from hypose.io.recordings.recording_views import DepthSource
from hypose.io.sensors.depth import write_depth_png
from hypose.synthetic.scenes import look_at
from tests.depth_pictures import seen_in_room
from tests.evidence.scenes import ellipse, iou, picture, ring, room

SHAPE, COUNT = (240, 320), 14
OPTIONS = FrameSettings(longer_side=320)


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """(recording, truth (C, T, h, w)): PNG folders, an empty room each, COCO key points as if in every view."""
    folder = tmp_path_factory.mktemp("film")
    rng = np.random.default_rng(8)
    truth, views = [], []
    for name in ("a", "b", "c"):
        background = room(rng, SHAPE)
        masks = [ellipse(SHAPE, t) for t in np.linspace(0.1, 0.9, COUNT)]
        for sub, images in (
            ("images", [picture(rng, background, m) for m in masks]),
            ("empty", [np.clip(background + rng.normal(0, 3, background.shape), 0, 255) for _ in range(12)]),
        ):
            path = folder / sub / name
            path.mkdir(parents=True)
            for i, image in enumerate(images):
                cv2.imwrite(str(path / f"{i:04d}.png"), image.astype(np.uint8))
        truth.append(masks)
        views.append(ViewSettings(name, {"images": folder / "images" / name, "background": folder / "empty" / name}))
    rig = CameraRig(tuple(replace(c, name=v.name) for c, v in zip(ring(3), views, strict=True)))
    return Recording(folder, "film", rig, tuple(views), 25.0, None, None, n_frames=COUNT), np.array(truth)


def test_masks_are_those_of_the_person(film):
    recording, truth = film
    with FrameStream(recording, OPTIONS) as stream:
        assert len(stream) == COUNT
        frames = list(stream)
    assert [f.index for f in frames] == list(range(COUNT)) and frames[5].time == pytest.approx(0.2)
    for t, frame in enumerate(frames):
        assert frame.silhouettes.usable.all()
        assert min(iou(m, truth[c, t]) for c, m in enumerate(frame.silhouettes.masks)) > 0.93


def test_any_order_and_a_new_stream_give_the_same_frames(film):
    recording, _ = film
    with FrameStream(recording, OPTIONS) as stream:
        frames = list(stream)
        backgrounds = stream.backgrounds
    with FrameStream(recording, OPTIONS, backgrounds) as resumed:
        for i in (11, 3, 12, 0):
            again = resumed.frame(i)
            assert np.array_equal(again.silhouettes.masks, frames[i].silhouettes.masks)
            assert again.silhouettes.reasons == frames[i].silhouettes.reasons
        with pytest.raises(InputError, match="frames 0 to 13; 14 was asked"):
            resumed.frame(14)
    with FrameStream(replace(recording, frame_range=(5, 9)), OPTIONS, backgrounds) as part:
        assert len(part) == 4 and (part.frame(1).index, part.frame(1).time) == (6, frames[6].time)
        assert np.array_equal(part.frame(1).silhouettes.masks, frames[6].silhouettes.masks)


def test_colours_are_those_of_the_pictures_within_the_masks(film, tmp_path):
    recording, _ = film
    coloured = replace(OPTIONS, colours=True)
    with FrameStream(recording, OPTIONS) as plain, FrameStream(recording, coloured, plain.backgrounds) as stream:
        write_masks(plain, tmp_path / "masks")
        assert plain.frame(0).colours is None
        pictures = stream.pictures()
        for i in (0, 5, 3):
            frame = stream.frame(i)
            assert frame.colours.seen.all()
            for c, mask in enumerate(frame.silhouettes.masks > 0):
                assert np.array_equal(frame.colours.codes[c][mask], colour_codes(pictures[c].image(i))[mask])
    masks = tuple(
        ViewSettings(v.name, {"images": v.files["images"], "masks": tmp_path / "masks" / v.name})
        for v in recording.views
    )
    with FrameStream(replace(recording, views=masks), coloured) as beside:  # masks made elsewhere, and the pictures
        again = beside.frame(3)
    mask = again.silhouettes.masks > 0
    assert np.array_equal(again.colours.codes[mask], frame.colours.codes[mask])
    alone = tuple(v.without("images") for v in masks)
    with FrameStream(replace(recording, views=alone), coloured) as nothing:
        assert nothing.frame(3).colours is None


def test_pictures_are_never_enlarged(film):
    recording, _ = film
    assert working_rig(recording.rig, FrameSettings(longer_side=160)).sizes.tolist() == [[160, 120]] * 3
    assert working_rig(recording.rig, FrameSettings(longer_side=4000)).sizes.tolist() == [[320, 240]] * 3


def test_views_that_fail_are_left_out_with_a_reason(film, tmp_path):
    recording, _ = film
    short, dark = tmp_path / "short", tmp_path / "dark"
    for path in (short, dark):
        path.mkdir()
    for i in range(COUNT):
        data = (recording.views[1].files["images"] / f"{i:04d}.png").read_bytes()
        (short / f"{i:04d}.png").write_bytes(data if i < 9 else b"cut off")
        empty = (recording.views[2].files["background"] / "0000.png").read_bytes()
        (dark / f"{i:04d}.png").write_bytes(
            empty if i == 6 else (recording.views[2].files["images"] / f"{i:04d}.png").read_bytes()
        )
    places = (recording.views[0].files["images"], short, dark)
    views = tuple(
        replace(v, files={**v.files, "images": path}) for v, path in zip(recording.views, places, strict=True)
    )
    with FrameStream(replace(recording, views=views), OPTIONS) as stream:
        frames, notes = list(stream), stream.notes
    assert any("View b has no mask in 5 frames, the first of them 9" in n and "0009.png" in n for n in notes)
    assert [f.silhouettes.usable.tolist() for f in (frames[5], frames[6], frames[10])] == [
        [True, True, True],
        [True, True, False],
        [True, False, True],
    ]
    assert "c, frame 6" in frames[6].silhouettes.reasons[2]
    assert "b, frame 10" in frames[10].silhouettes.reasons[1] and "damaged" in frames[10].silhouettes.reasons[1]


def test_masks_written_are_read_back_exactly(film, tmp_path):
    recording, _ = film
    with FrameStream(recording, OPTIONS) as stream:
        frames = list(stream)
        seen = []
        write_masks(stream, tmp_path, lambda done, total: seen.append((done, total)))
    assert seen[-1] == (COUNT, COUNT)
    views = tuple(ViewSettings(v.name, {"masks": tmp_path / v.name}) for v in recording.views)
    with FrameStream(replace(recording, views=views), OPTIONS) as stream:
        assert stream.backgrounds == (None, None, None)
        for a, b in zip(stream, frames, strict=True):
            assert np.array_equal(a.silhouettes.masks, b.silhouettes.masks)


def test_masks_from_elsewhere_are_undistorted_and_shifted(tmp_path):
    camera = replace(ring(1)[0], distortion=np.array([-0.25, 0.05, 0.0, 0.0, 0.0]))
    rig = CameraRig((camera,))
    circle = np.stack([camera.position * 0 + [0.5 * np.cos(a), 0.5 * np.sin(a), 0.9] for a in np.linspace(0, 6.28, 80)])
    outline = camera.project(circle) - [5, 0]  # stored 5 px too far left
    mask = np.zeros(SHAPE, np.uint8)
    cv2.fillPoly(mask, [np.rint(outline).astype(np.int32)], 255)
    cv2.imwrite(str(tmp_path / "0.png"), mask)
    recording = Recording(
        tmp_path, "m", rig, (ViewSettings("c1", {"masks": tmp_path}, (5.0, 0.0)),), 25.0, None, None, n_frames=1
    )
    with FrameStream(recording, OPTIONS) as stream:
        found = stream.frame(0).silhouettes.masks[0]
    truth = np.zeros(SHAPE, np.uint8)
    cv2.fillPoly(truth, [np.rint(camera.project_pinhole(circle)).astype(np.int32)], 1)
    assert iou(found, truth) > 0.95


def keypoint_files(folder, first, count, lag=0, skip=(), names=25):
    folder.mkdir()
    for t in range(count):
        if t in skip:
            continue
        points = np.column_stack([50 + t + lag + np.arange(names), 3.0 * np.arange(names) + 20, np.full(names, 0.9)])
        text = json.dumps({"people": [{"pose_keypoints_2d": points.ravel().tolist()}]})
        (folder / f"x_{first + t:06d}_keypoints.json").write_text(text)
    return folder


def test_key_points_are_matched_by_number_with_the_lag(film, tmp_path):
    recording, _ = film
    views = (
        ViewSettings("a", {"keypoints": keypoint_files(tmp_path / "a", 1, COUNT, lag=2)}),
        ViewSettings("b", {"keypoints": keypoint_files(tmp_path / "b", 1, COUNT, lag=2, skip=(0, 4))}),
        recording.views[2],
    )
    r = replace(recording, views=views, keypoint_set="BODY_25", keypoint_lag=2)
    with FrameStream(r, FrameSettings(longer_side=320, masks=False)) as stream:
        frames = list(stream)
    assert frames[0].silhouettes is None
    points = np.stack([f.keypoints.points for f in frames])
    assert (points[:2, ..., 2] == 0).all()  # no file for the first two frames
    assert np.allclose(points[2:, 0, 0, 0], 50 + np.arange(2, COUNT))
    assert points[6, 1, 0, 2] == 0 and points[7, 1, 0, 2] > 0 and (points[:, 2, :, 2] == 0).all()
    (tmp_path / "a" / "x_000003_keypoints.json").write_text("{}")
    with pytest.raises(InputError, match="x_000003_keypoints.json"):
        FrameStream(r, FrameSettings(masks=False))


def test_key_points_of_image_pixels_are_scaled(film, tmp_path):
    recording, _ = film
    folder = keypoint_files(tmp_path / "a", 0, COUNT)
    views = tuple(replace(v, files={**v.files, "keypoints": folder}) for v in recording.views)
    big = CameraRig(tuple(c.scaled((640, 480)) for c in recording.rig))
    r = replace(recording, rig=big, views=views, keypoint_set="BODY_25", keypoint_pixels="image")
    with FrameStream(r, FrameSettings(longer_side=320, masks=False)) as stream:
        assert stream.frame(3).keypoints.points[1, 0, 0] == pytest.approx(53, abs=1e-6)


# ---- real recordings -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_uu4cam_masks_agree_with_the_students(shared_data):
    recording = uu4cam_recording(shared_data("uu4cam"))
    made = ((v.name, v.files["video"].with_name("foreground_mask.avi")) for v in recording.views)
    students = tuple(ViewSettings(name, {"masks": masks}) for name, masks in made)
    with FrameStream(recording) as ours, FrameStream(replace(recording, views=students)) as theirs:
        found = []
        for i in range(0, 426, 142):
            a, b = ours.frame(i).silhouettes, theirs.frame(i).silhouettes
            # their masks hold a moved chessboard beside the man, ours the ceiling's lamps
            pairs = [(biggest_parts(x, 1.0), biggest_parts(y, 1.0)) for x, y in zip(a.masks, b.masks, strict=True)]
            found.append([iou(x, y) for x, y in pairs])
            assert a.usable.all()
    assert np.mean(found) >= 0.9 and np.mean(found, axis=0).min() >= 0.87


def balancing(folder, keypoints):
    return replace(balancing_recording(folder, keypoints=keypoints), frame_range=(1, 100))


LIMBS = [(a, a + 2) for a in (5, 6, 7, 8, 11, 12, 13, 14)]


@pytest.mark.slow
def test_balancing_masks_hold_the_limbs_in_all_views(shared_data):
    folder = shared_data("pose2sim_balancing")
    with (
        FrameStream(balancing(folder, False)) as stream,
        FrameStream(balancing(folder, True), FrameSettings(masks=False)) as detected,
    ):
        hits, areas = np.zeros((4, 2)), []
        for i in range(0, 99, 14):
            frame, points = stream.frame(i), detected.frame(i).keypoints.points
            assert frame.silhouettes.usable.all()
            areas.append(frame.silhouettes.areas)
            for c, (mask, p) in enumerate(zip(frame.silhouettes.masks, points, strict=True)):
                for a, b in LIMBS:
                    for s in (0.2, 0.5, 0.8):
                        u, v = np.rint(p[a, :2] * (1 - s) + p[b, :2] * s).astype(int)
                        if min(p[a, 2], p[b, 2]) > 0.5 and 0 <= u < 272 and 0 <= v < 480:
                            hits[c] += [mask[v, u], 1]
        assert (hits[:, 0] / hits[:, 1]).min() >= 0.93, hits[:, 0] / hits[:, 1]
        assert np.max(areas) < 16_000  # a man, no observer and no mats


def test_balancing_key_points_agree_with_the_reference(shared_data):
    folder = shared_data("pose2sim_balancing")
    with FrameStream(balancing(folder, True), FrameSettings(masks=False)) as stream:
        frames = [f.keypoints for f in stream]
    assert frames[0].names == BODY_25B
    points, residual, _ = triangulate_keypoints(frames)
    reference = np.load(folder / "kp3d_refined_m.npy")[:99]  # of the key-point files, which lag one frame
    error = np.linalg.norm(points - reference, axis=-1)
    assert np.nanmedian(error) < 0.002 and np.nanpercentile(error, 95) < 0.05
    assert np.nanmedian(residual) < 3
    assert np.isnan(error).mean() < np.isnan(reference).any(-1).mean() + 0.03


# ---- test depth views ----------------------------------------------------------------------------------------------
# Depth maps of a view by frame number: lenses, sizes, and what is damaged.


CAMERA = look_at("d", (0, 0, 1.3), (0, 2.6, 0.6), 120.0, (160, 120))


def written(folder, frames=6):
    """A recording of a board that stands before an empty room; recording.toml's path."""
    for name, person in (("depth", True), ("room", False)):
        (folder / name).mkdir()
        for k in range(frames):
            write_depth_png(folder / name / f"{k:03d}.png", seen_in_room(CAMERA, person))
    view = ViewSettings("d", {"depth": folder / "depth", "background": folder / "room"})
    rig = CameraRig((CAMERA,))
    return write_recording(Recording(folder, "r", rig, (view,), 25.0, None, keypoint_set=None, n_frames=frames), folder)


def test_one_damaged_map_and_one_of_another_size_cost_their_frames(tmp_path):
    toml = written(tmp_path)
    whole = (tmp_path / "depth/002.png").read_bytes()
    (tmp_path / "depth/002.png").write_bytes(whole[: len(whole) // 2])
    write_depth_png(tmp_path / "depth/003.png", seen_in_room(CAMERA)[::2, ::2])
    with FrameStream(load_recording(toml)) as frames:
        found = [f.silhouettes for f in frames]
        assert len(frames.notes) == 1 and "frame" in frames.notes[0] and "002.png" in frames.notes[0]
    assert [bool(f.usable[0]) for f in found] == [True, True, False, False, True, True]
    assert "003.png is 80 x 60 px" in found[3].reasons[0]


def test_a_fisheye_lens_is_straightened_without_coefficients_too(tmp_path):
    bent = replace(CAMERA, distortion=np.zeros(4), fisheye=True)
    write_depth_png(tmp_path / "0.png", np.tile(np.linspace(1, 3, 160, dtype=np.float32), (120, 1)))
    view = ViewSettings("d", {"depth": tmp_path})
    assert (
        np.abs(DepthSource(view, bent, bent.pinhole()).map(0) - DepthSource(view, CAMERA, CAMERA).map(0)).max() > 0.02
    )


def test_large_pictures_beside_them_make_maps_no_smaller(tmp_path):
    toml = written(tmp_path)
    alone = load_recording(toml)
    large = replace(CAMERA.scaled((1280, 960)), name="c")
    beside = replace(alone, rig=CameraRig((CAMERA, large)), views=(alone.views[0], ViewSettings("c")))
    with FrameStream(alone) as one, FrameStream(beside) as both:
        assert both.rig.sizes.tolist() == [[160, 120], [480, 360]]
        maps = both.frame(0).depth.maps
        assert np.array_equal(maps[0, :120, :160], one.frame(0).depth.maps[0]) and not maps[1].any()
