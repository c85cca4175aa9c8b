"""Sentences that lead to the next step: wrong units, exchanged colours, guessed sizes, empty results, names."""

from dataclasses import replace

from benchmarks.robustness.small_recordings import write_skeletons
from hypose.io.motions.results import load_motion, save_motion


def said(result):
    code, _, err = result
    assert code == 2 and "Traceback" not in err, err
    return err[err.index("error: ") :].strip()


def test_milliseconds_are_not_taken_for_seconds(hypose, tmp_path):
    folder = write_skeletons(tmp_path / "rec", seconds=1.0)
    rows = [line.split(",") for line in (folder / "frames.csv").read_text().splitlines()]
    late = [rows[0], *([s, n, f"{1000 * float(t):.1f}"] for s, n, t in rows[1:])]
    (folder / "frames.csv").write_text("\n".join(map(",".join, late)) + "\n")
    sentence = said(hypose("fuse", folder))
    assert "the frames of the sensor sensor0 lie 33.3 s apart, and times are seconds" in sentence
    assert "divide milliseconds by 1000" in sentence


def test_a_result_of_no_frames_has_no_report(hypose, tracked, tmp_path):
    motion = load_motion(tracked / "motion.npz")
    fields = (
        "times",
        "poses",
        "joints",
        "joint_covariance",
        "lost",
        "extrapolated",
        "n_views",
        "cost",
        "low_confidence",
    )
    fields += (
        "error_probability",
        "low_confidence_joints",
        "angle_sd",
        "systematic_covariance",
        "rivals",
        "rival_weights",
    )
    none = {name: v[:0] for name in fields if (v := getattr(motion, name)) is not None}
    save_motion(replace(motion, **none), tmp_path / "motion.npz")
    assert "no frames" in said(hypose("report", tmp_path / "motion.npz"))
    assert "no frames" in said(hypose("report", tmp_path)) and not (tmp_path / "report.html").exists()
