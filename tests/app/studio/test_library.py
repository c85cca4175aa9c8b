"""Recordings and results are deleted with a way back, and renamed; never what a job is at work on."""

import pytest

from tests.app.studio.conftest import serving


def state_of(client):
    state = client.get("/api/state")
    return state["recordings"], state["results"]


def test_a_result_is_deleted_and_brought_back(own_studio, folder):
    (recording,), (result,) = state_of(own_studio)
    place = folder / "walk" / "results" / "default"
    before = (place / "motion.npz").read_bytes()
    own_studio.ask(f"/api/results/{result['id']}/view")
    deleted = own_studio.get(f"/api/results/{result['id']}", method="DELETE")
    assert (
        deleted["name"] == "default"
        and not place.exists()
        and state_of(own_studio)
        == (
            [{**recording, "results": []}],
            [],
        )
    )
    own_studio.get(f"/api/results/{result['id']}/view", status=404)
    assert own_studio.get(f"/api/trash/{deleted['trash']}", {})["id"] == result["id"]
    assert (place / "motion.npz").read_bytes() == before and own_studio.ask(f"/api/results/{result['id']}/view")[
        0
    ] == 200
    assert own_studio.get(f"/api/trash/{deleted['trash']}", {}, status=404)["error"]


def test_a_recording_goes_with_its_results_and_is_gone_with_the_server(folder):
    with serving(folder) as client:
        (recording,), _ = state_of(client)
        deleted = client.get(f"/api/recordings/{recording['id']}", method="DELETE")
        assert state_of(client) == ([], []) and not (folder / "walk").exists()
        client.get(f"/api/trash/{deleted['trash']}", {})
        assert [len(x) for x in state_of(client)] == [1, 1]
        client.get(f"/api/recordings/{recording['id']}", method="DELETE")
    assert not (folder / ".studio-trash").exists() and not (folder / "walk").exists()


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
    (recording,), _ = state_of(own_studio)
    job = own_studio.get("/api/jobs", {"kind": "check", "recording": recording["id"]}, status=201)
    for ask in ({"method": "DELETE"}, {"value": {"name": "other"}}):
        path = f"/api/recordings/{recording['id']}" + ("" if "method" in ask else "/name")
        assert "stop it first" in own_studio.get(path, status=409, **ask)["error"]
    own_studio.get(f"/api/jobs/{job['id']}/cancel", {})


@pytest.mark.parametrize("kind", ["recordings", "results"])
def test_the_served_folder_itself_is_not_deleted(folder, kind):
    root = folder / "walk" if kind == "recordings" else folder / "walk" / "results" / "default"
    with serving(root) as client:
        recordings, results = state_of(client)
        own = [i for i in (*recordings, *results) if i["path"] in (root.name, ".")][-1]
        assert "from outside" in client.get(f"/api/{kind}/{own['id']}", method="DELETE", status=400)["error"]
    assert root.is_dir()
