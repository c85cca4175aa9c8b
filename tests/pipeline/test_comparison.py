"""Results against other motions: what was done to a motion is found again, and its figures are those of plain numpy."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.robustness.keypoint_layouts import walker
from hypose.app.cli import run_cli
from hypose.body.default_body import human
from hypose.body.joint_angles import joint_angles
from hypose.body.motion import Motion, isotropic
from hypose.errors import InputError
from hypose.geometry import se3, so3_exp, transform
from hypose.io.motions.marker_files import read_mot, write_c3d, write_mot, write_trc
from hypose.io.motions.results import save_body, save_motion
from hypose.pipeline.comparison import CompareOptions, OtherMotion, compare_motions, read_other

NAMES = ("left_hip", "left_knee", "left_ankle", "right_knee", "left_elbow", "right_wrist")


def motion(frames=150, sd=0.01, lost=()):
    body, poses = human(), walker(frames)
    joints = body.joints(poses)
    flags = np.isin(np.arange(frames), lost)
    none = np.zeros(frames, bool)
    return Motion(body.skeleton, np.arange(frames) / 25, joints, poses, isotropic(np.full(joints.shape[:2], sd)), flags,
                  none, np.full(frames, 4), np.full(frames, 0.1))  # fmt: skip


def test_place_time_and_offsets_are_found(tmp_path, rng):
    """The same movement at 100/s, begun 0.61 s earlier, in another world, with other ideas of hip and knee."""
    ours = motion()
    fine = np.interp
    index = [ours.skeleton.joint(n) for n in NAMES]
    at = np.arange(0, ours.times[-1] - 0.5, 0.01)
    points = np.stack([[fine(at, ours.times, ours.joints[:, j, a]) for a in range(3)] for j in index]).transpose(
        2, 0, 1
    )
    points = points + 0.004 * rng.standard_normal(points.shape)
    world = se3(so3_exp([0.3, -0.2, 2.0]), [4.0, -1.0, 0.3])
    other = OtherMotion(tmp_path, at + 0.61, {n: transform(world, points[:, i]) for i, n in enumerate(NAMES)})
    found = compare_motions(ours, other)
    assert found.offset == pytest.approx(-0.61, abs=0.004)
    assert np.allclose(found.ours_from_other @ world, np.eye(4), atol=0.004)
    assert [a.name for a in found.joints] == list(ours.skeleton.joint_names[j] for j in sorted(index))
    for a in found.joints:
        assert a.rmse == pytest.approx(0.004 * np.sqrt(3) * 1000, rel=0.15) and a.offset < 1.5
        assert min(a.r) > 0.9 or a.unit != "mm"


def test_another_movement_is_told_and_the_same_one_is_not(tmp_path, rng):
    """The same with 40 mm of noise, or much of it unseen; another one, and one in another world."""
    ours, names = motion(), motion().skeleton.joint_names

    def reported(joints, options=None):
        other = OtherMotion(tmp_path / "other.trc", ours.times, dict(zip(names, joints.swapaxes(0, 1), strict=True)))
        return [n for n in compare_motions(ours, other, options).notes if "hardly the same movement" in n]

    noisy = ours.joints + 0.04 * rng.standard_normal(ours.joints.shape)
    gaps = np.where(rng.random(noisy.shape[:2])[..., None] < 0.3, np.nan, noisy)
    assert reported(noisy) == reported(gaps) == []
    body, still = human(), walker(150)
    still[:, 6:] = 0.3 * np.sin(np.arange(150)[:, None] / 7 + np.arange(still.shape[1] - 6))
    other = body.joints(body.skeleton.clamp(still))
    (sentence,) = reported(other)
    assert sentence.startswith("At no offset within 5 s do the joints of other.trc move as ours do")
    assert reported(other, CompareOptions(offset=0.0))[0].startswith("At the offset that was given")
    turned = ours.joints @ so3_exp([0, 0, np.pi / 2]).T
    assert reported(turned) == [] and "--no-align" in reported(turned, CompareOptions(align=False))[0]


def test_figures_are_those_of_an_independent_script(tmp_path, rng):
    ours = motion(lost=(3, 4, 5))
    noise = {n: rng.normal(0, [0.004, 0.008, 0.012], (len(ours), 3)) for n in NAMES}
    points = {n: ours.joints[:, ours.skeleton.joint(n)] + d for n, d in noise.items()}
    points["left_hip"][20:30] = np.nan
    found = compare_motions(ours, OtherMotion(tmp_path, ours.times, points), CompareOptions(offset=0.0, align=False))
    for a in found.joints:
        rows = np.ones(len(ours), bool)
        rows[3:6] = False
        if a.name == "left_hip":
            rows[20:30] = False
        d = 1000 * noise[a.name][rows]
        distance = np.sqrt(d[:, 0] ** 2 + d[:, 1] ** 2 + d[:, 2] ** 2)
        assert a.n == rows.sum()
        assert abs(a.median - np.sort(distance)[[(len(d) - 1) // 2, len(d) // 2]].mean()) < 0.01
        assert abs(a.p95 - np.quantile(distance, 0.95)) < 0.01
        assert abs(a.rmse - (distance @ distance / len(d)) ** 0.5) < 0.01
        assert np.allclose(a.bias, d.sum(0) / len(d), atol=0.01)
        assert np.allclose(a.high - a.low, 2 * 1.96 * np.sqrt(((d - d.mean(0)) ** 2).sum(0) / (len(d) - 1)), atol=0.01)
        mine = ours.joints[rows, ours.skeleton.joint(a.name)]
        wanted = [np.corrcoef(mine[:, k], points[a.name][rows, k])[0, 1] for k in range(3)]
        assert np.allclose(a.r, wanted, atol=1e-9)


def test_angles_of_opensim(tmp_path, rng):
    ours = motion()
    names, values = joint_angles(ours.skeleton, ours.poses)
    noisy = values + np.radians(2) * rng.standard_normal(values.shape)
    noisy[:, names.index("knee_angle_r")] += np.radians(10)
    write_mot(tmp_path / "a.mot", names, noisy, ours.times)
    write_mot(tmp_path / "motion_sd.sto", names, noisy, ours.times)
    (tmp_path / "motion_sd.sto").rename(tmp_path / "b.sto")
    with pytest.raises(InputError, match=r"b\.sto holds the standard deviations"):
        read_other(tmp_path / "b.sto")
    times, read, back = read_mot(tmp_path / "a.mot")
    assert read == names and np.allclose(back, noisy, atol=1e-9) and np.allclose(times, ours.times)
    found = compare_motions(ours, read_other(tmp_path / "a.mot"), CompareOptions(offset=0.0))
    by_name = {a.name: a for a in found.angles}
    knee, hip = by_name["knee_angle_r"], by_name["hip_flexion_l"]
    assert knee.offset == pytest.approx(10, abs=0.6) and knee.rmse_left == pytest.approx(2, rel=0.2)
    assert knee.rmse == pytest.approx(np.hypot(10, 2), rel=0.1)
    assert hip.offset < 0.6 and hip.rmse == pytest.approx(2, rel=0.2) and hip.r[0] > 0.9
    assert by_name["pelvis_tx"].unit == "mm"


def test_files_of_several_people_are_asked_about(tmp_path):
    ours = motion(40)
    names = ours.skeleton.joint_names
    both = np.concatenate([ours.joints, ours.joints + [1.0, 0, 0]], 1)
    labels = [f"{who}:{n}" for who in ("Ben", "Anna") for n in names]
    write_c3d(tmp_path / "a.c3d", labels, both, 25, subjects=["Ben", "Anna"])
    with pytest.raises(InputError, match=r"a\.c3d holds points of Ben, Anna"):
        read_other(tmp_path / "a.c3d")
    with pytest.raises(InputError, match="has no points of 'Eve', they are of Ben, Anna"):
        read_other(tmp_path / "a.c3d", subject="Eve")
    anna = read_other(tmp_path / "a.c3d", {"left_knee": ("left_knee",)}, "Anna").points
    np.testing.assert_allclose(
        anna["left_knee"], ours.joints[:, ours.skeleton.joint("left_knee")] + [1, 0, 0], atol=1e-5
    )
    write_c3d(tmp_path / "b.c3d", labels[len(names) :], ours.joints, 25)  # one person: as Vicon names a subject's
    one = read_other(tmp_path / "b.c3d", {"head": ("Anna:head", "neck")}).points
    np.testing.assert_allclose(one["left_hip"], ours.joints[:, ours.skeleton.joint("left_hip")], atol=1e-5)
    write_c3d(tmp_path / "c.c3d", names, ours.joints, 25)
    with pytest.raises(InputError, match="named without a subject"):
        read_other(tmp_path / "c.c3d", subject="Anna")


def test_marker_files_of_labs(tmp_path):
    """Joint centres by their usual names, pairs of markers, and the middle of markers that the user names."""
    ours = motion(40)
    j = {n: ours.joints[:, i] for i, n in enumerate(ours.skeleton.joint_names)}
    names = ("RHip", "LHJC", "r_knee_study", "r_mknee_study", "LKNE", "LKNM", "C7")
    side = np.array([0.05, 0, 0])
    points = (j["right_hip"], j["left_hip"], j["right_knee"] + side, j["right_knee"] - side, j["left_knee"] + side,
              j["left_knee"] - side, j["neck"])  # fmt: skip
    write_trc(tmp_path / "a.trc", names, np.stack(points, 1), 25)
    write_c3d(tmp_path / "a.c3d", names, np.stack(points, 1), 25)
    for name in ("a.trc", "a.c3d"):
        other = read_other(tmp_path / name, {"left_knee": ("LKNE", "LKNM")})
        assert set(other.points) == {"right_hip", "left_hip", "right_knee", "left_knee"}
        assert np.abs(other.points["right_knee"] - j["right_knee"]).max() < 1e-5
        assert np.abs(other.points["left_knee"] - j["left_knee"]).max() < 1e-5
    with pytest.raises(InputError, match=r"has no marker 'XX'"):
        read_other(tmp_path / "a.trc", {"left_knee": ("XX",)})
    write_trc(tmp_path / "b.trc", ("a1", "a2"), np.stack(points[:2], 1), 25)
    with pytest.raises(InputError, match=r"None of the points of .*b\.trc is called like a joint \(a1, a2\)"):
        read_other(tmp_path / "b.trc")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x\n", r"is not an OpenSim motion file: its header has no endheader"),
        ("a\nendheader\ntime\n", r"must name time and the coordinates"),
        ("a\nendheader\ntime a\n0 1\n0 2\n", r"times that do not increase"),
        ("a\nendheader\ntime a\n0 1 2\n", r"line 4 has 3 numbers, 2 are needed"),
        ("a\nendheader\ntime a\n0 x\n", r"line 4 holds something that is not"),
    ],
)
def test_bad_mot(tmp_path, text, message):
    (tmp_path / "a.mot").write_text(text)
    with pytest.raises(InputError, match=message):
        read_mot(tmp_path / "a.mot")


def run(*arguments):
    with pytest.raises(SystemExit) as caught:
        run_cli([str(a) for a in arguments])
    return caught.value.code or 0


def test_the_command(tmp_path, capsys):
    ours = motion(60)
    (tmp_path / "r").mkdir()
    save_motion(ours, tmp_path / "r" / "motion.npz")
    save_body(human(), tmp_path / "r" / "body.npz")
    moved = ours.joints + 0.02 * np.sin(9 * ours.times)[:, None, None]
    write_trc(tmp_path / "m.trc", ours.skeleton.joint_names, moved, 25)
    save_motion(replace(ours, joints=moved), tmp_path / "other.npz")
    assert run("compare", tmp_path / "r", tmp_path / "m.trc", tmp_path / "r", tmp_path / "other.npz", "--no-align") == 0
    said = capsys.readouterr().out
    assert "joints, offsets aside: median" in said and "compare.html" in said
    page = (tmp_path / "r" / "compare.html").read_text()
    assert (
        "m.trc" in page
        and "other.npz" in page
        and "http:" not in page.replace("http://www.w3.org", "")
        and "https:" not in page
    )
    table = (tmp_path / "r" / "compare.csv").read_text().splitlines()
    assert table[0].startswith("result,other,name,unit,frames,median,p95,rmse,offset")
    assert any(",left_knee,mm,60," in row for row in table) and any(",knee_angle_l,deg,60," in row for row in table)
    assert run("compare", tmp_path / "r", tmp_path / "m.trc", "--no-align", "--offset", 0, "--max-mm", 5) == 1
    assert "RMSE is" in capsys.readouterr().out
    assert run("compare", tmp_path / "r", tmp_path / "m.trc", "--no-align", "--offset", 0, "--max-mm", 50) == 0
    assert run("compare", tmp_path / "r") == 2
    assert "one of the files has no partner" in capsys.readouterr().err
    assert run("compare", tmp_path / "r", tmp_path / "m.trc", "--joint", "knee=A") == 2
    assert "--joint knee=A is not possible" in capsys.readouterr().err


def other_of(ours, path, points):
    return OtherMotion(path, ours.times, dict(zip(ours.skeleton.joint_names, points.swapaxes(0, 1), strict=True)))


@pytest.mark.parametrize("factor", [1000, 100, 39.37, 0.001])
def test_a_wrong_unit_is_known_by_the_bones(tmp_path, factor):
    ours = motion()
    found = compare_motions(ours, other_of(ours, tmp_path / "other.trc", factor * ours.joints))
    assert found.left_mm[2] < 1 and found.offset == 0
    assert any("its unit is not" in n for n in found.notes)


def test_a_left_handed_world_is_mirrored(tmp_path):
    ours = motion()
    found = compare_motions(ours, other_of(ours, tmp_path / "other.trc", ours.joints * [1, 1, -1]))
    assert found.left_mm[2] < 1 and any("left-handed" in n for n in found.notes)
    assert not any("left-handed" in n for n in compare_motions(ours, other_of(ours, tmp_path, ours.joints)).notes)


def test_numbers_that_stand_for_not_seen_are_dropped(tmp_path):
    ours = motion()
    points = ours.joints.copy()
    points[40:60, 3], points[10:20, 5] = -9.999, points[9, 5]
    found = compare_motions(ours, other_of(ours, tmp_path / "other.trc", points))
    assert found.left_mm[2] < 1 and any("repeat to the last digit" in n for n in found.notes)
    assert np.isnan(found.errors[45, 3]) and np.isfinite(found.errors[45, 4])


def test_points_of_one_name_are_left_out(shared_data):
    other = read_other(shared_data("outside_cases") / "compare" / "dup.c3d")
    assert "left_hip" not in other.points and any("LHip" in n for n in other.notes)
