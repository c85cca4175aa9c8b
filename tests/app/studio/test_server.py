"""Who may talk to the studio, what it gives away, and what it does not."""

import contextlib
import json
import os
import shutil
import socket

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from hypose.app.commands.commands_live import view
from hypose.app.live.servers import token_for
from hypose.app.studio import server as studio_server
from hypose.calibration.findings import Finding
from hypose.pipeline.assessment import Assessment
from tests.app.studio.conftest import serving
from tests.bundles import read_bundle
from tests.conftest import HANG_S


def test_the_state_lists_what_lies_in_the_folder(studio):
    state = studio.get("/api/state")
    (recording,) = state["recordings"]
    (result,) = state["results"]
    assert recording["path"] == "walk" and recording["results"] == [result["id"]]
    assert result["path"] == "walk/results/default" and result["recording"] == recording["id"]
    assert result["frames"] == 8 and result["complete"] and result["title"] == "walk: default"
    assert [s["value"] for s in state["sources"]][:1] == ["simulated:0"] and state["jobs"] == []
    assert [r["id"] for r in studio.get("/api/results")] == [result["id"]]


def test_a_result_is_one_block_with_its_pictures_and_outlines(studio):
    id = studio.result
    status, headers, block = studio.ask(f"/api/results/{id}/view")
    header, arrays = read_bundle(block)
    assert status == 200 and header["frames"] == 8 and arrays["joints"].shape == (8, 19, 3)
    assert "default-src 'self'" in headers["content-security-policy"]
    _, _, pictures = studio.ask(f"/api/results/{id}/pictures/3?width=100")
    count, *lengths = memoryview(pictures)[:20].cast("I")
    assert count == 4 and len(pictures) == 20 + sum(lengths) and pictures[20:22] == b"\xff\xd8"
    assert len(studio.get(f"/api/results/{id}/outlines/3")["views"]) == 4
    status, headers, data = studio.ask(f"/api/results/{id}/files/motion.trc")
    assert status == 200 and data.startswith(b"PathFileType") and "attachment" in headers["content-disposition"]
    _, headers, _ = studio.ask(f"/api/results/{id}/files/report.html")  # cannot reach the server
    assert headers["content-security-policy"].startswith("sandbox allow-scripts; default-src 'none'")


def test_what_lies_beside_a_motion_is_read_again_when_it_changes(own_studio, folder):
    """Its assessment, its files, whether it is all, and the cameras of its recording."""
    results = folder / "walk" / "results" / "default"

    def header():
        return read_bundle(own_studio.ask(f"/api/results/{own_studio.result}/view")[2])[0]

    before = header()
    assert before["complete"] and "motion.trc" in {f["name"] for f in before["files"]}
    (results / "motion.trc").unlink()
    kept = Assessment("not to be trusted", (Finding("moved", (), "the camera moved"),)).document()
    (results / "assessment.json").write_text(json.dumps(kept))
    (results / "checkpoint.npz").write_bytes(b"")
    toml = folder / "walk" / "recording.toml"
    toml.write_text(toml.read_text().replace('name = "cam2"', 'name = "cam2"\nimage_shift = [3.0, -2.0]', 1))
    now = header()
    assert not now["complete"] and "motion.trc" not in {f["name"] for f in now["files"]}
    assert now["assessment"]["word"] == "not to be trusted" and now["cameras"][1]["image_shift"] == [3, -2]
    (reported,) = own_studio.get("/api/state")["results"]
    assert reported["assessment"] == "not to be trusted" and not reported["complete"]


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/api/results/0123456789ab/view", 404),
        ("/api/results/..%2f..%2f..%2fetc%2fpasswd/view", 404),
        ("/api/results/RESULT/pictures/8", 400),
        ("/api/results/RESULT/pictures/-1", 404),
        ("/api/results/RESULT/pictures/1?width=100000", 400),
        ("/api/results/RESULT/files/..%2fcalibration.toml", 404),
        ("/api/results/RESULT/files/checkpoint.npz", 404),
        ("/api/recordings/RESULT", 404),
        ("/api/recordings/RECORDING/file/..%2frecording.toml", 404),
        ("/api/recordings/RECORDING/image/cam9/0.jpg", 404),
        ("/api/recordings/RECORDING/image/cam1/0.jpg?mask=all", 400),
        ("/api/recordings/RECORDING/image/cam1/8.jpg", 400),
        ("/api/recordings/RECORDING/image/cam1/1.jpg?mask=edge&settings=many", 400),
        ("/api/recordings/RECORDING/starts/..%2f..%2frecording", 404),
        ("/api/jobs/none", 404),
        ("/static/../server.py", 404),
        ("/static/..%2fserver.py", 404),
        ("/static/%2e%2e/server.py", 404),
        ("/nothing", 404),
    ],
)
def test_nothing_else_is_given_away(studio, path, status):
    state = studio.get("/api/state")
    path = path.replace("RESULT", state["results"][0]["id"]).replace("RECORDING", state["recordings"][0]["id"])
    got, _, body = studio.ask(path)
    assert got == status
    assert status == 404 or json.loads(body)["error"].endswith(".")
    assert b"root:" not in body and b"import" not in body


def test_links_out_of_the_folder_lead_nowhere(own_studio, folder, tmp_path):
    secret = tmp_path / "secret"
    secret.mkdir()
    report = folder / "walk/results/default/report.html"
    report.unlink()
    (secret / "report.html").write_text("secret")
    os.symlink(secret / "report.html", report)
    assert own_studio.ask(f"/api/results/{own_studio.result}/files/report.html")[0] == 404


@pytest.mark.parametrize(
    "headers",
    [{"Origin": "http://evil.example"}, {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"}, {"Origin": "http://[x"}],
)
def test_a_foreign_page_can_change_nothing(studio, headers):
    for path, method in (("/api/jobs", "POST"), ("/api/recordings", "POST"), ("/api/results/0", "DELETE")):
        assert studio.ask(path, {}, method=method, headers=headers)[0] in (400, 403)
    if "Origin" in headers:
        with pytest.raises(InvalidStatus) as refused:
            studio.socket("/ws/jobs", origin=headers["Origin"])
        assert refused.value.response.status_code == 403


def test_the_own_page_and_programs_may(studio):
    own = f"http://127.0.0.1:{studio.port}"
    assert studio.ask("/api/jobs", {}, headers={"Origin": own})[0] == 400  # heard, and then found wanting
    for host, status in (("evil.example", 403), (f"localhost:{studio.port}", 200)):  # a foreign name is refused
        assert studio.ask("/api/state", headers={"Host": host})[0] == status
    for origin in (own, None):
        with studio.socket("/ws/jobs", origin=origin) as ws:
            assert json.loads(ws.recv(HANG_S)) == {"t": "jobs", "jobs": []}


def test_an_oversized_message_ends_the_connection(studio):
    for path in ("/ws/jobs", "/ws/gesture", "/ws/fuse"):
        with studio.socket(path) as ws:
            ws.recv(HANG_S)
            with pytest.raises(ConnectionClosed) as closed:
                ws.send("x" * 70_000)
                while True:
                    ws.recv(HANG_S)
            assert closed.value.rcvd.code == 1009
    assert studio.ask("/api/fit-clicks", data=b"[" * (2 << 20))[0] == 400
    assert studio.ask("/api/fit-clicks", data=b"[" * 9000)[0] == 400


def test_too_many_connections_are_refused(served):
    with serving(served) as studio, contextlib.ExitStack() as stack:  # its own: places are free again after a moment
        with pytest.raises(ConnectionClosed) as closed:
            for _ in range(17):
                stack.enter_context(studio.socket("/ws/jobs")).recv(HANG_S)
        assert closed.value.rcvd.code == 1013


def test_others_than_this_computer_need_the_token(served):
    assert token_for("0.0.0.0") and token_for("127.0.0.1") == ""
    with serving(served, host="0.0.0.0", token="secret") as client:
        assert client.ask("/api/state")[0] == 401
        assert client.ask("/api/state?token=wrong")[0] == 401
        assert client.ask("/api/state?token=secret")[0] == 200
        assert client.ask("/api/state", headers={"Authorization": "Bearer secret"})[0] == 200
        assert client.ask("/static/none.js")[0] == 404  # the page itself is no secret
        with pytest.raises(InvalidStatus) as refused:
            client.socket("/ws/jobs")
        assert refused.value.response.status_code == 403
        with client.socket("/ws/jobs?token=secret") as ws:
            assert json.loads(ws.recv(HANG_S))["t"] == "jobs"


def test_without_a_page_the_server_says_what_to_do(served, monkeypatch, tmp_path):
    monkeypatch.setattr(studio_server, "STATIC_FOLDER", tmp_path / "none")
    with serving(served) as client:
        status, _, body = client.ask("/")
        assert status == 503 and b"hatch_build.py" in body
        assert client.ask("/static/studio.js")[0] == 404


def test_view_says_why_it_cannot_start(hypose, monkeypatch, served, tmp_path):
    monkeypatch.setattr(studio_server, "STATIC_FOLDER", tmp_path)
    code, _, err = hypose("view", served)
    assert code == 2 and "hatch_build.py" in err
    (tmp_path / "index.html").write_text("page")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        code, _, err = hypose("view", served, "--port", taken.getsockname()[1], "--no-browser")
    assert code == 2 and "cannot be used" in err and "--port" in err


def test_a_recording_with_results_opens_in_view(folder, monkeypatch, capsys):
    (folder / "index.html").write_text("the page, built or not")

    def opened(path):
        monkeypatch.setattr(studio_server, "STATIC_FOLDER", folder)
        monkeypatch.setattr(studio_server, "run_server", lambda *given: given[-1]("http://here/"))
        view(path, port=0, no_browser=True)
        return capsys.readouterr().out.split("#/")[1].split("/")[0].strip()

    assert opened(folder / "walk") == "view"
    assert opened(folder / "walk" / "results" / "default") == "view"
    shutil.rmtree(folder / "walk" / "results")
    assert opened(folder / "walk") == "setup"
