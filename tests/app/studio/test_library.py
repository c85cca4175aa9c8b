"""Results are deleted for good; never what a job is at work on."""

import shutil

from tests.app.studio.conftest import serving


def state_of(client):
    state = client.get("/api/state")
    return state["recordings"], state["results"]


def test_a_result_is_deleted_for_good_and_links_in_it_are_not_followed(own_studio, folder, tmp_path):
    (recording,), (result,) = state_of(own_studio)
    place, kept = folder / "walk" / "results" / "default", folder / "kept"
    kept.mkdir()
    (kept / "file").write_text("kept")
    (place / "link").symlink_to(kept)
    own_studio.ask(f"/api/results/{result['id']}/view")
    assert own_studio.get(f"/api/results/{result['id']}", method="DELETE") == {"name": "default"}
    assert not place.exists() and (kept / "file").read_text() == "kept"
    assert state_of(own_studio) == ([{**recording, "results": []}], [])
    own_studio.get(f"/api/results/{result['id']}/view", status=404)
    own_studio.ask(f"/api/recordings/{recording['id']}", method="DELETE")
    assert (folder / "walk" / "recording.toml").is_file() and [
        p.name for p in folder.iterdir() if p.name[0] == "."
    ] == []


def test_a_result_in_which_others_lie_is_not_deleted(own_studio, folder):
    place = folder / "walk" / "results" / "default"
    shutil.copytree(place, place / "inner")
    outer = next(r for r in state_of(own_studio)[1] if r["path"] == "walk/results/default")
    assert "others lie in it" in own_studio.get(f"/api/results/{outer['id']}", method="DELETE", status=400)["error"]
    assert (place / "motion.npz").is_file()


def test_what_a_job_is_at_work_on_stays(own_studio):
    _, (result,) = state_of(own_studio)
    job = own_studio.get(
        "/api/jobs", {"kind": "export", "result": result["id"], "options": {"formats": ["trc"]}}, status=201
    )
    refused = own_studio.get(f"/api/results/{result['id']}", method="DELETE", status=409)
    assert "stop it first" in refused["error"]
    own_studio.get(f"/api/jobs/{job['id']}/cancel", {})


def test_the_served_folder_itself_is_not_deleted(folder):
    root = folder / "walk" / "results" / "default"
    with serving(root) as client:
        ((own,), _) = state_of(client)[::-1]
        assert "from outside" in client.get(f"/api/results/{own['id']}", method="DELETE", status=400)["error"]
    assert root.is_dir()
