"""`hypose subject`: a scan becomes a body that the tracker follows; a recording gives sizes, a body and a picture."""

import json
import tomllib

import numpy as np
import pytest

from benchmarks.synthetic.scans import scan_of
from hypose.io.motions.results import load_body, load_motion
from hypose.pipeline.assessment import EXIT_UNTRUSTED
from hypose.synthetic.subjects import load_subjects


def write_ply(path, vertices, faces):
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {k}" for k in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(f"{c:.5f}" for c in v) for v in vertices]
    lines += ["3 " + " ".join(str(i) for i in f) for f in faces]
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.slow
def test_a_scan_is_rigged_and_tracked(hypose, tiny, tmp_path):
    subject = load_subjects()["neutral"]
    vertices, _ = scan_of(subject, "a", 0.001, np.random.default_rng(1))
    write_ply(tmp_path / "scan.ply", 100 * vertices, subject.faces)
    code, _, err = hypose("subject", "--mesh", tmp_path / "scan.ply", "--out", tmp_path / "anna")
    assert code == 2 and "give the unit 'cm'" in err
    code, out, err = hypose("subject", "--mesh", tmp_path / "scan.ply", "--unit", "cm", "--out", tmp_path / "anna")
    assert code == 0, err
    assert "coordinates in cm became metres" in (out + err).replace("\n", " ")
    body = load_body(tmp_path / "anna" / "body.npz")
    assert body.stature == pytest.approx(subject.stature, abs=0.02)
    track = "track", tiny, "--frames", "4:8", "--subject", tmp_path / "anna", "--out", tmp_path / "out", "--no-overlay"
    code, _, err = hypose(*track)
    assert code in (0, EXIT_UNTRUSTED), err  # arms of a few pixels may be right and not trusted
    motion = load_motion(tmp_path / "out" / "motion.npz")
    away = np.linalg.norm(motion.joints - np.load(tiny / "truth.npz")["joints"][4:8], axis=-1)
    assert away.mean() < 0.08
    # the tracked body is the scan, not the template
    np.testing.assert_allclose(motion.skeleton.rest_offsets, body.skeleton.rest_offsets)
    assert len(motion.times) == 4 and float(np.nanmean(motion.cost)) < 0.35
    used = json.loads((tmp_path / "out" / "provenance.json").read_text())
    assert "anna" in json.dumps(used)


@pytest.mark.slow
def test_a_recording_gives_sizes_a_body_and_a_picture(hypose, tiny, tmp_path):
    out = tmp_path / "anna"
    code, printed, err = hypose("subject", tiny, "--out", out, "--poses", "3")
    assert code == 0, err
    assert "Stature" in printed
    sizes = tomllib.loads((out / "subject.toml").read_text())["sizes"]
    true = load_subjects()["neutral"].stature
    assert sizes["stature"]["cm"] == pytest.approx(100 * true, abs=6)
    assert (out / "subject.png").read_bytes()[:4] == b"\x89PNG"
