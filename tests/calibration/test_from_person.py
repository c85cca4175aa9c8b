"""Cameras from one person who walks about: found with an honest uncertainty, or refused in a sentence."""

import json

import numpy as np
import pytest

from benchmarks.cameras.boardless import errors, without_poses
from benchmarks.synthetic.wandering import RATE, WanderingSettings, wandering
from hypose.app.cli import run_cli
from hypose.app.commands.commands_calibrate import with_focal_lengths
from hypose.calibration.from_person import calibrate_from_person
from hypose.calibration.sync_motion import Curves
from hypose.calibration.two_views import rival_offsets
from hypose.errors import CalibrationError, InputError
from hypose.evidence.keypoints import BODY_25
from hypose.io.calibrations.calibration_formats import read_any, write_calibration
from hypose.io.videos.video import writing_video


def _solve(scene, known, largest_s=None):
    lenses = without_poses(scene.rig, known)
    return calibrate_from_person(
        scene.points, BODY_25, lenses, scene.height, RATE, lenses_known=known, largest_s=largest_s
    )


@pytest.fixture(scope="module")
def walk():
    """Three cameras, 11 s, and what is found with known lenses."""
    scene = wandering(4, WanderingSettings(cameras=3, seconds=11.0, largest=15.0))
    return scene, _solve(scene, True)


def test_cameras_offsets_vertical_and_floor_of_a_walk(walk):
    scene, found = walk
    e = errors(found, scene.rig, scene.late)
    assert max(e["turn_deg"]) < 0.7 and max(e["place_mm"]) < 60 and max(e["place_by_height_mm"]) < 180
    assert max(e["lag_frames"]) < 0.2 and max(e["up_deg"]) < 1.0
    assert abs(np.mean(found.rig.positions[:, 2] - scene.rig.positions[:, 2])) < 0.08  # the floor is z = 0
    assert found.approximate == ()


def test_the_uncertainty_covers_the_error(walk):
    scene, found = walk
    e = errors(found, scene.rig, scene.late)
    assert max(np.abs(np.r_[e["over_turn"], e["over_place"], e["over_lag"]])) < 4
    assert (found.sds.turn_deg < 0.5).all() and (found.sds.place_m < 0.06).all() and not found.sds.focal.any()


def test_two_cameras_need_their_focal_lengths():
    with pytest.raises(CalibrationError, match="--intrinsics"):
        _solve(wandering(0, WanderingSettings(cameras=2, seconds=2.0)), False)


def test_walking_in_a_circle_is_refused():
    with pytest.raises(CalibrationError, match="how late the cameras are.*--largest"):
        _solve(wandering(2, WanderingSettings(cameras=3, motion="circle", seconds=14.0)), True)


def test_a_short_clip_is_flagged_and_a_shorter_one_refused():
    scene = wandering(1, WanderingSettings(cameras=3, seconds=4.0, largest=4.0))
    found = _solve(scene, True, 0.3)
    assert any("short" in text for text in found.approximate)
    with pytest.raises(CalibrationError, match="in common"):
        _solve(wandering(1, WanderingSettings(cameras=3, seconds=0.8, largest=4.0)), True, 0.3)


def test_cameras_on_one_side_are_refused():
    with pytest.raises(CalibrationError, match="same side"):
        _solve(wandering(3, WanderingSettings(cameras=3, spread_deg=5.0, seconds=10.5, largest=3.0)), True, 0.2)


def test_videos_that_start_seconds_apart():
    scene = wandering(5, WanderingSettings(cameras=3, seconds=14.0, largest=100.0))
    assert np.ptp(scene.late) > 1.5 * RATE
    e = errors(_solve(scene, True), scene.rig, scene.late)
    assert max(e["lag_frames"]) < 0.3


def test_the_true_principal_point_is_used():
    scene = wandering(7, WanderingSettings(cameras=3, seconds=11.0, largest=4.0, centre_px=30.0))
    e = errors(_solve(scene, True, 0.3), scene.rig, scene.late)
    assert max(e["turn_deg"]) < 0.7


@pytest.mark.slow
def test_three_cameras_with_unknown_lenses_are_flagged():
    scene = wandering(4, WanderingSettings(cameras=3, largest=10.0))
    found = _solve(scene, False, 0.7)
    e = errors(found, scene.rig, scene.late)
    assert any("three cameras" in text for text in found.approximate)
    assert max(np.abs(np.r_[e["over_focal"], e["over_place"]])) < 3


@pytest.mark.slow
def test_lens_distortion_is_found_with_the_focal_lengths():
    scene = wandering(8, WanderingSettings(cameras=4, size=(640, 480), distorted=True, bias_px=0.0, largest=10.0))
    found = _solve(scene, False, 0.7)
    e = errors(found, scene.rig, scene.late)
    assert max(e["focal_pct"]) < 3.5 and max(e["turn_deg"]) < 0.8
    assert (np.array([c.distortion[0] for c in found.rig]) < -0.05).all()


def test_rival_offsets_are_the_second_dip():
    lags = np.arange(-20.0, 21.0)
    dips = 10 - 8 * np.exp(-(((lags - 3) / 2) ** 2)) - 7 * np.exp(-(((lags + 12) / 2) ** 2))
    worse, rival = rival_offsets(Curves(((0, 1),), lags, dips[None]), np.array([0.0, 3.0]))
    assert rival[1] - rival[0] == -12 and worse == pytest.approx(3 / 2 - 1, rel=0.01)


def exit_code(arguments):
    """The exit code of a command."""
    with pytest.raises(SystemExit) as left:
        run_cli(arguments)
    return left.value.code or 0


def _recording(folder, scene, videos=False):
    """A recording of key points, with or without videos of a dark room."""
    lines = ['keypoint_set = "BODY_25"', f"frame_rate = {RATE}"]
    for camera, view in zip(scene.rig, scene.points, strict=True):
        (folder / camera.name).mkdir(parents=True)
        for t, p in enumerate(view):
            people = {"people": [{"pose_keypoints_2d": p.ravel().round(2).tolist()}]}
            (folder / camera.name / f"{camera.name}_{t:012d}_keypoints.json").write_text(json.dumps(people))
        lines += ["[[view]]", f'name = "{camera.name}"', f'keypoints = "{camera.name}"']
        if videos:
            with writing_video(folder / f"{camera.name}.mp4", RATE, camera.size) as writer:
                for _ in scene.points[0]:
                    writer.write(np.zeros((*camera.size[::-1], 3), np.uint8))
            lines.append(f'video = "{camera.name}.mp4"')
    (folder / "recording.toml").write_text("\n".join(lines))
    write_calibration(without_poses(scene.rig, True), folder / "lenses.toml")
    return folder


@pytest.mark.parametrize("option", ["--intrinsics", "--focal"])
def test_the_command_writes_calibration_and_offsets(tmp_path, capsys, option):
    scene = wandering(4, WanderingSettings(cameras=3, seconds=4.0, largest=4.0))
    folder = _recording(tmp_path / "walk", scene, option == "--focal")
    command = ["calibrate", str(folder), "--from-person", "--largest", "0.3"]
    if option == "--focal":
        command += [f"--focal={c.name}={c.K[0, 0]:.1f}" for c in scene.rig]
    else:
        command += ["--intrinsics", str(folder / "lenses.toml")]
    assert exit_code(command) == 2 and "--height 1.72" in capsys.readouterr().err
    assert exit_code([*command, "--height", f"{scene.height:.3f}"]) == 0
    said = capsys.readouterr().out
    assert "approximate: 4.0 s are short" in said and "hypose sync" in said
    rig, _ = read_any(folder / "calibration.toml")
    assert rig.names == scene.rig.names and np.ptp(rig.positions[:, 0]) > 1
    views = json.loads((folder / "results" / "sync.json").read_text())["views"]
    late = np.array([v["late"] for v in views])
    assert np.abs(late - np.median(late) - scene.late + np.median(scene.late)).max() < 0.5
    before = (folder / "calibration.toml").read_bytes()
    assert exit_code([*command, "--height", "1.7"]) == 2 and "never overwritten" in capsys.readouterr().err
    assert (folder / "calibration.toml").read_bytes() == before


@pytest.mark.parametrize("given, named", [(["cam9=900"], "cam1, cam2"), (["cam1=big"], "PIXELS"), (["cam1=9"], "cam2")])
def test_focal_lengths_that_do_not_fit_the_cameras(given, named):
    rig = without_poses(wandering(0, WanderingSettings(cameras=2, seconds=1.0)).rig, False)
    with pytest.raises(InputError, match=named):
        with_focal_lengths(rig, given)
    assert [c.K[1, 1] for c in with_focal_lengths(rig, ["900", "cam2=1000.5"])] == [900, 1000.5]


def test_a_refusal_writes_nothing(tmp_path, capsys):
    scene = wandering(4, WanderingSettings(cameras=2, seconds=2.0, largest=0.0))
    folder = _recording(tmp_path / "two", scene)
    assert exit_code(["calibrate", str(folder), "--from-person", "--height", "1.7"]) == 2
    assert "no pictures" in capsys.readouterr().err and not (folder / "calibration.toml").exists()
