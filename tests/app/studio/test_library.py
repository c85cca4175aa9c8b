"""Results are deleted for good, recordings and results renamed; never what a job is at work on."""

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
    assert "lie in default" in own_studio.get(f"/api/results/{outer['id']}", method="DELETE", status=400)["error"]
    assert (place / "motion.npz").is_file()


def test_names_are_changed_and_kept_apart(own_studio, folder):
    (recording,), (result,) = state_of(own_studio)
    renamed = own_studio.get(f"/api/results/{result['id']}/name", {"name": "first-try"})
    assert (folder / "walk" / "results" / "first-try" / "motion.npz").is_file() and renamed["id"] != result["id"]
    own_studio.get(f"/api/recordings/{recording['id']}/name", {"name": "monday"})
    (recording,), (result,) = state_of(own_studio)
    assert recording["path"] == "monday" and result["path"] == "monday/results/first-try"
    (folder / "tuesday").mkdir()
    for name, status in (("tuesday", 409), ("../x", 400), ("", 400), (".x", 400), (7, 400)):
        assert own_studio.get(f"/api/recordings/{recording['id']}/name", {"name": name}, status=status)["error"]
    assert (folder / "monday").is_dir()


def test_what_a_job_is_at_work_on_stays(own_studio):
    (recording,), (result,) = state_of(own_studio)
    job = own_studio.get("/api/jobs", {"kind": "check", "recording": recording["id"]}, status=201)
    renaming = own_studio.get(f"/api/recordings/{recording['id']}/name", {"name": "other"}, status=409)
    assert "stop it first" in renaming["error"]
    own_studio.get(f"/api/jobs/{job['id']}/cancel", {})


def test_the_served_folder_itself_is_not_deleted(folder):
    root = folder / "walk" / "results" / "default"
    with serving(root) as client:
        ((own,), _) = state_of(client)[::-1]
        assert "from outside" in client.get(f"/api/results/{own['id']}", method="DELETE", status=400)["error"]
    assert root.is_dir()
