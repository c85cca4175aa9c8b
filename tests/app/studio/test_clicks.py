"""What the page clicks is what `hypose track --recipe monocular` starts from."""

import json

import numpy as np
import pytest

from hypose.app.studio.catalog import Catalog
from hypose.app.studio.clicks import _for_one_camera
from hypose.app.studio.job_kinds import plan_job
from hypose.errors import InputError
from hypose.io.recordings.recording import load_recording
from hypose.pipeline.one_camera import clicked_pixels, load_clicks
from hypose.pipeline.recorded_frames import one_view
from tests.bundles import read_bundle

PIXELS = {
    "neck": (75, 30), "left_shoulder": (82.62, 32.5), "left_elbow": (85, 45), "left_wrist": (86.25, 55),
    "left_hip": (80, 60), "left_knee": (80.5, 75), "left_ankle": (81, 90.06), "head_top": (75, 20),
}  # fmt: skip


def view(camera, hidden=()):
    points = [{"joint": j, "x": x, "y": y, "occluded": j in hidden} for j, (x, y) in PIXELS.items()]
    return {"camera": camera, "points": points}


def test_undistorted_clicks_come_back_through_the_lens(tiny, tmp_path):
    recording = load_recording(tiny)
    name = recording.rig.names[1]
    kept = _for_one_camera([view(recording.rig.names[0]), view(name)], name, recording)
    assert kept["camera"] == recording.views[1].name
    assert set(kept["joints"]) == set(PIXELS) - {"head_top"}  # the tracker knows joints of the body only
    path = tmp_path / "clicks.json"
    path.write_text(json.dumps({**kept, "joints": {k: list(v) for k, v in kept["joints"].items()}}))
    one = one_view(recording, kept["camera"])
    back = clicked_pixels(load_clicks(path, one), one, recording.rig[1].pinhole())
    for joint, pixel in back.items():
        np.testing.assert_allclose(pixel, PIXELS[joint], atol=1e-3)


def test_the_body_that_is_fitted_comes_as_a_block_of_one_frame(studio):
    state = studio.get("/api/state")
    recording, result = state["recordings"][0]["id"], state["results"][0]["id"]

    def height(query):
        _, arrays = read_bundle(studio.ask(f"/api/click-body?{query}")[2])
        assert arrays["rotations"].shape == (1, 19, 4) and np.isfinite(arrays["rotations"]).all()
        return float(np.ptp(arrays["fine_vertices"][:, 2]))

    usual, tall = height(f"recording={recording}"), height(f"recording={recording}&height=1.95")
    assert tall == pytest.approx(1.95, abs=0.03) and abs(usual - tall) > 0.05
    assert height(f"recording={recording}&result={result}") == pytest.approx(
        height(f"recording={recording}&result={result}&height=1.95")
    ), "a person who was measured keeps their height"
    for query in ("", f"recording={recording}&height=tall", f"recording={recording}&height=9", "recording=../x"):
        assert studio.ask(f"/api/click-body?{query}")[0] in (400, 404)


def test_a_correction_is_a_result_of_its_own(folder):
    catalog = Catalog(folder)
    (result,) = catalog.items("result")
    starts = folder / "walk" / "starts"
    starts.mkdir()
    (starts / "arm.json").write_text(json.dumps({"format": "hypose-clicks", "frame": 3, "pose": [0.0] * 36}))
    request = {"result": result.id, "options": {"start": "clicks:arm", "until": 6}}
    made = plan_job("correct", request, catalog)
    results = folder / "walk" / "results"
    assert made.arguments == (
        *("correct", str(results / "default"), str(starts / "arm.json"), "--until=6"),
        *("--out", str(results / "default-corrected")),
    )
    assert made.result == catalog.id_of("result", results / "default-corrected") and "frame 3" in made.title
    (results / "default").rename(
        results / "default-corrected"
    )  # corrected once more, it is no default-corrected-corrected
    again = {**request, "result": catalog.id_of("result", results / "default-corrected")}
    assert plan_job("correct", again, catalog).arguments[-1].endswith("default-corrected-2")
    for start in (None, "default", "clicks:none", "clicks:../arm"):
        with pytest.raises(InputError):
            plan_job("correct", {**again, "options": {"start": start} if start else {}}, catalog)
