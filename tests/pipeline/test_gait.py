"""Gait of a walk whose steps are known, its files, and what nobody walks in."""

import ezc3d
import numpy as np
import pytest

from hypose.app.cli import run_cli
from hypose.app.reports.report import gait_section
from hypose.app.studio.view_bundle import gait_values
from hypose.body.default_body import human
from hypose.body.motion import Motion, isotropic
from hypose.errors import InputError
from hypose.io.motions.results import save_body, save_motion
from hypose.pipeline.gait import angle_cycles, gait_of, strides

RATE, SPEED, CADENCE = 60.0, 1.2, 1.8  # Hz, m/s, steps/s


def walking(seconds=4.0, turn=0.0, noise=0.0, sd=0.008, still=False):
    """The default body walks along its facing direction; joint centres with an error that moves slowly."""
    body = human()
    skeleton = body.skeleton
    t = np.arange(round(seconds * RATE)) / RATE
    phase, swing = np.pi * CADENCE * t, 0.0 if still else 1.0
    moves = {
        "pelvis_tz": 0.93 + 0.02 * np.cos(2 * phase),
        "pelvis_tx": swing * SPEED * t * np.sin(turn),
        "pelvis_ty": -swing * SPEED * t * np.cos(turn),
        "pelvis_rz": np.full(len(t), turn),
        "left_hip_rx": -0.42 * swing * np.sin(phase),
        "right_hip_rx": 0.42 * swing * np.sin(phase),
        "left_knee_flexion": 0.35 - 0.3 * swing * np.cos(phase + 0.4),
        "right_knee_flexion": 0.35 + 0.3 * swing * np.cos(phase + 0.4),
    }
    poses = np.zeros((len(t), skeleton.dof))
    for name, values in moves.items():
        poses[:, skeleton.dof_names.index(name)] = values
    joints, none = body.joints(poses), np.zeros(len(t), bool)
    sds = isotropic(np.full(joints.shape[:2], sd))
    return Motion(skeleton, t, joints, poses, sds, none, none, np.full(len(t), 4), np.full(len(t), 0.1)), body


@pytest.mark.parametrize("turn", [0.0, 0.8, 2.5, -2.0])
def test_steps_of_a_walk_in_any_direction(turn):
    gait = gait_of(*walking(turn=turn))
    strikes = [e for e in gait.events if e.kind == "strike"]
    assert [e.side for e in strikes[:-1]] != [e.side for e in strikes[1:]]
    assert np.allclose(np.diff([e.time for e in strikes]), 1 / CADENCE, atol=0.6 / RATE)
    figures = {f.name: f for f in gait.figures}
    assert figures["cadence"].mean == pytest.approx(60 * CADENCE, rel=0.01)
    assert figures["speed"].mean == pytest.approx(SPEED, rel=0.03)
    assert figures["step_length_left"].mean == pytest.approx(figures["step_length_right"].mean, abs=0.005)
    assert all(s.length > 0.4 and s.width < 0.45 for s in gait.steps)
    assert all(f.low < f.mean < f.high for f in gait.figures)


def test_strike_is_where_the_heel_is_farthest_in_front():
    """The left thigh swings as -sin: it is foremost a quarter of a stride after the right one was."""
    motion, body = walking()
    heel = body.landmark_points(motion.poses)[:, body.landmarks.index("left_heel")]
    front = -(heel - motion.joints[:, 0])[:, 1]
    for event in gait_of(motion, body).events:
        if (event.side, event.kind) == ("left", "strike"):
            k = round(event.time * RATE)
            around = front[max(0, k - 12) : k + 13]
            assert abs(int(np.argmax(around)) - min(12, k)) <= 1


def test_cycles_lay_strides_over_each_other():
    """A hip swings as a sine whose cycle is the stride: the mean of the strides is that sine, and they are alike."""
    motion, body = walking(seconds=6.0)
    motion = Motion(**{**motion.__dict__, "angle_sd": np.full((len(motion), 32), np.radians(2.0), np.float32)})
    events = gait_of(motion, body).events
    cycles = {c.name: c for c in angle_cycles(events, motion)}
    hip = cycles["hip_flexion_r"]
    assert hip.n == len(strides(events, motion, "right")) >= 3
    assert np.degrees(np.ptp(hip.mean)) == pytest.approx(np.degrees(0.84), abs=1.0)
    assert np.degrees(hip.sd.max()) < 1.5
    assert abs(hip.mean[0] - hip.mean[-1]) < np.radians(1.5)
    alone = np.degrees(hip.uncertainty)
    assert (alone < 2.0).all() and (alone > 2.0 / np.sqrt(hip.n) - 0.01).all()  # a mean is known better than a frame
    opposite = cycles["hip_flexion_l"].mean - hip.mean  # each from its own foot's strike
    assert np.degrees(np.abs(opposite).max()) < 3.0
    assert "pelvis_rotation" not in cycles and "pelvis_tx" not in cycles


def test_nobody_walks():
    still = walking(still=True)
    gait = gait_of(*still)
    assert gait.events == () and gait.steps == () and gait.figures == () and gait_section(gait_values(*still)) == ""


def test_without_poses_there_is_no_gait():
    motion, body = walking()
    without = Motion(**{**motion.__dict__, "poses": None})
    with pytest.raises(InputError, match="gait needs poses"):
        gait_of(without, body)
    assert gait_section(gait_values(motion, None)) == "" == gait_section(gait_values(without, body))


def test_a_report_has_the_gait_of_who_walks():
    gait = gait_values(*walking(seconds=6.0))
    assert all(words in gait_section(gait) for words in ("<h2>Gait</h2>", "cadence", "steps/min"))
    assert gait["events"] and all(len(c["mean"]) == len(c["sd"]) == 101 for c in gait["cycles"])


def test_the_command_and_its_files(tmp_path, capsys):
    motion, body = walking()
    save_motion(motion, tmp_path / "motion.npz")
    save_body(body, tmp_path / "body.npz")
    with pytest.raises(SystemExit) as caught:
        run_cli(["gait", str(tmp_path)])
    assert not caught.value.code
    said = capsys.readouterr().out
    assert "foot strikes" in said and "cadence: 10" in said
    events = (tmp_path / "events.csv").read_text().splitlines()
    gait = gait_of(motion, body)
    assert events[0] == "time_s,sd_s,side,event,x_m,y_m,z_m,frame" and len(events) == len(gait.events) + 1
    assert len((tmp_path / "steps.csv").read_text().splitlines()) == len(gait.steps) + 1
    assert "cadence,steps/min," in (tmp_path / "gait.csv").read_text()
    cycles = (tmp_path / "cycles.csv").read_text().splitlines()
    assert len(cycles) == 102 and cycles[0].startswith("percent,") and "knee_angle_l_sd_deg" in cycles[0]
    marks = ezc3d.c3d(str(tmp_path / "gait.c3d"))["parameters"]["EVENT"]
    assert marks["USED"]["value"][0] == len(gait.events)
    assert marks["LABELS"]["value"] == ["Foot Strike" if e.kind == "strike" else "Foot Off" for e in gait.events]
    assert marks["CONTEXTS"]["value"] == [e.side.capitalize() for e in gait.events]
    assert np.allclose(np.array(marks["TIMES"]["value"])[1], [e.time for e in gait.events], atol=1e-4)
