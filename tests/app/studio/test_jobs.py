"""Jobs: what the page asks for is the command that is run; progress, stopping, going on, refusals."""

import json
import time

import numpy as np
import pytest

from hypose.app.studio.catalog import Catalog
from hypose.app.studio.job_kinds import JOB_KINDS, plan_job
from hypose.errors import InputError
from hypose.io.motions.results import load_motion
from tests.bundles import read_bundle
from tests.conftest import HANG_S


def wait(client, id, *states):
    for _ in range(int(HANG_S * 5)):
        job = client.get(f"/api/jobs/{id}")
        if job["state"] in states:
            return job
        time.sleep(0.2)
    raise AssertionError(job)


def test_options_become_the_command(folder):
    catalog = Catalog(folder)
    (item,) = catalog.items("recording")
    options = {"recipe": "hpf", "refine": True, "frames": "0:4", "formats": ["trc", "bvh"], "overlay": False}
    made = plan_job("track", {"recording": item.id, "options": {**options, "name": "try-1"}}, catalog)
    path, out = str(item.path), str(item.path / "results" / "try-1")
    assert made.arguments == (
        *("track", path, "--recipe=hpf", "--refine", "--frames=0:4", "--formats=trc,bvh"),
        *("--no-overlay", "--out", out),
    )
    assert made.resumable and made.result == catalog.id_of("result", item.path / "results" / "try-1")
    measured = plan_job("track", {"recording": item.id, "options": {"subject": True, "name": "try-1"}}, catalog)
    assert measured.arguments == ("track", path, "--out", out, "--subject", str(item.path / "subject"))
    assert plan_job("refine", {"recording": item.id}, catalog).arguments == ("check", path, "--refine")
    assert plan_job("demo", {}, catalog).arguments == ("demo", "--out", str(folder / "demo"))


def test_a_track_takes_a_name_that_is_free(folder):
    """Nothing that was tracked is written over."""
    catalog = Catalog(folder)
    (item,) = catalog.items("recording")

    def planned(**options):
        return plan_job("track", {"recording": item.id, "options": options}, catalog).folder

    assert planned() == planned(name="default") == item.path / "results" / "default-2"
    (item.path / "results" / "default-2").mkdir()
    assert planned(name="default-2").name == "default-3"
    assert planned(recipe="hpf").name == "hpf"


@pytest.mark.parametrize(
    ("value", "text"), [(1234567, "1234567"), (4.0, "4"), (123456.75, "123456.75"), (0.1, "0.1"), (-3, "-3")]
)
def test_numbers_reach_the_command_as_they_are(folder, value, text):
    assert plan_job("demo", {"options": {"seed": value}}, Catalog(folder)).arguments[-1] == f"--seed={text}"


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("format-disk", {}),
        ("track", {"no-such": 1}),
        ("track", {"recipe": "/etc/passwd"}),
        ("track", {"start": "../../etc/passwd"}),
        ("track", {"recipe": "a\nb"}),
        ("track", {"seed": float("nan")}),
        ("track", {"seed": {}}),
        ("track", {"formats": []}),
        ("track", {"name": "../../escape"}),
        ("track", {"name": ".hidden"}),
        ("track", ["recipe"]),
    ],
)
def test_options_that_cannot_be_are_refused(folder, kind, options):
    catalog = Catalog(folder)
    (item,) = catalog.items("recording")
    with pytest.raises(InputError):
        plan_job(kind, {"recording": item.id, "options": options}, catalog)


def test_what_a_page_gives_belongs_to_its_option_and_is_no_file(folder):
    catalog = Catalog(folder)
    (item,) = catalog.items("recording")
    options = {"far": "yes", "height": "--out=x", "using": "keypoints"}
    made = plan_job("refine", {"recording": item.id, "options": options}, catalog).arguments
    assert made == ("check", str(item.path), "--refine", "--from=keypoints", "--far=yes", "--height=--out=x")


def test_every_kind_needs_something_that_is_there(folder):
    catalog = Catalog(folder)
    for kind in JOB_KINDS:
        if kind != "demo":
            with pytest.raises(InputError):
                plan_job(kind, {}, catalog)


def test_forms_are_the_options_of_the_commands(own_studio):
    forms = own_studio.get("/api/job-forms")
    assert set(forms) == set(JOB_KINDS)
    evidence, height = ({o["name"]: o for o in forms["track"]}[n] for n in ("evidence", "height"))
    assert evidence["choices"][:3] == ["silhouettes", "keypoints", "both"] and evidence["help"]
    assert (height["kind"], height["least"], height["most"], height["default"]) == ("float", 0.4, 2.8, None)


def test_an_export_runs_and_tells(own_studio, folder):
    (folder / "walk/results/default/motion.trc").unlink()
    with own_studio.socket("/ws/jobs") as ws:
        assert json.loads(ws.recv(HANG_S))["t"] == "jobs"
        asked = {"kind": "export", "result": own_studio.result, "options": {"formats": ["trc"]}}
        job = own_studio.get("/api/jobs", asked, status=201)
        assert job["state"] in ("queued", "running") and job["command"].endswith("--formats=trc")
        reported = []
        while not reported or reported[-1]["t"] != "files":
            reported.append(json.loads(ws.recv(HANG_S)))
    states = [m["job"]["state"] for m in reported if m["t"] == "job"]
    assert states[-1] == "done" and "running" in states
    assert (folder / "walk/results/default/motion.trc").is_file()
    assert any("motion.trc" in line for line in own_studio.get(f"/api/jobs/{job['id']}")["lines"])


def test_a_failed_job_says_the_command_lines_sentence(own_studio):
    job = own_studio.get(
        "/api/jobs", {"kind": "export", "result": own_studio.result, "options": {"formats": ["fbx"]}}, status=201
    )
    job = wait(own_studio, job["id"], "failed")
    assert "fbx" in job["error"] and "the formats are" in job["error"] and not job["resumable"]
    assert own_studio.get(f"/api/jobs/{job['id']}/cancel", {}, status=409)["error"]
    assert own_studio.get(f"/api/jobs/{job['id']}/resume", {}, status=409)["error"]
    assert own_studio.get(f"/api/jobs/{job['id']}/view", status=404)["error"]


def test_jobs_wait_for_each_other_and_can_be_called_off(own_studio):
    recording = own_studio.recording
    first = own_studio.get("/api/jobs", {"kind": "check", "recording": recording}, status=201)
    second = own_studio.get("/api/jobs", {"kind": "silhouettes", "recording": recording}, status=201)
    assert own_studio.get(f"/api/jobs/{second['id']}")["state"] == "queued"
    assert own_studio.get(f"/api/jobs/{second['id']}/cancel", {})["state"] == "cancelled"
    first = wait(own_studio, first["id"], "done")
    assert [s["name"] for s in first["stages"]][:2] == ["background", "check"]
    check = own_studio.get(f"/api/recordings/{recording}")["check"]
    assert check["healthy"] and check["facts"] and check["page"] == "check.html" and len(check["views"]) == 4
    assert own_studio.ask(f"/api/recordings/{recording}/file/check.html")[0] == 200


@pytest.mark.slow
def test_tracking_is_stopped_with_its_work_kept_and_resumed_to_the_same_motion(own_studio, folder, served):
    """Also: a closed page loses nothing, because no page is open here at all."""
    recording = own_studio.recording
    ask = {"kind": "track", "recording": recording, "options": {"name": "again", "formats": ["csv"], "overlay": False}}
    job = own_studio.get("/api/jobs", ask, status=201)
    assert own_studio.get("/api/jobs", ask, status=409)["error"]
    for _ in range(3000):
        stages = {s["name"]: s for s in own_studio.get(f"/api/jobs/{job['id']}")["stages"]}
        if stages.get("track", {}).get("done", 0) >= 1:
            break
        time.sleep(0.05)
    own_studio.get(f"/api/jobs/{job['id']}/cancel", {})
    stopped = wait(own_studio, job["id"], "cancelled", "done")
    out = folder / "walk" / "results" / "again"
    if stopped["state"] == "cancelled":  # it may have been too fast
        assert stopped["resumable"] and (out / "checkpoint.npz").is_file()
        if shown := own_studio.ask(f"/api/jobs/{job['id']}/view")[2]:  # else it was stopped before a frame was kept
            header, arrays = read_bundle(shown)
            assert 1 <= header["frames"] <= 8 and not header["complete"] and "fine_vertices" in arrays
        resumed = own_studio.get(f"/api/jobs/{job['id']}/resume", {}, status=201)
        assert resumed["command"].endswith("--resume")
        wait(own_studio, resumed["id"], "done")
    motion, reference = load_motion(out / "motion.npz"), load_motion(served / "walk/results/default/motion.npz")
    np.testing.assert_array_equal(motion.poses, reference.poses)
