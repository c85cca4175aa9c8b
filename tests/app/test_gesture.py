"""`hypose gesture`: a session of the simulated person, learned, watched, exported; what is wrong is named."""

import json
import shutil
import socket
import threading
import time

import numpy as np
import pytest
from websockets.sync.client import connect

from hypose.app.cli import run_cli
from hypose.app.jobs.gesture_job import gesture_lines, run_session, watch
from hypose.app.live.gestures import GestureSource, Taken, Teaching, Watched, Watching, open_source
from hypose.app.live.servers import SocketListeners
from hypose.errors import EvidenceError, InputError
from hypose.gestures.depth_pictures import DepthLens
from hypose.gestures.events import Event
from hypose.gestures.localise import Localisation
from hypose.gestures.model import GestureModel
from hypose.gestures.online import Learner
from hypose.gestures.trainer import SessionSettings
from hypose.pipeline.gesture_files import SessionWriter, read_recording, save_model
from tests.conftest import HANG_S


def run(capsys, *arguments):
    """(exit code, stdout, stderr) of `hypose gesture`."""
    with pytest.raises(SystemExit) as stopped:
        run_cli(["gesture", *map(str, arguments)])
    printed = capsys.readouterr()
    return stopped.value.code or 0, printed.out, " ".join(printed.err.split())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A session of a few frames (phases shortened) recorded and learned once."""

    root = tmp_path_factory.mktemp("gesture")
    source = open_source("simulated:1", "pause", 3)
    settings = SessionSettings(do_gesture_s=1.0, positive_s=2.0, release_s=0.2, negative_s=1.5, rounds=2)
    model = run_session(Teaching(source, "pause", settings, record=root / "session"))
    save_model(model, root / "pause.npz")
    return root


def test_a_session_is_recorded_with_its_phases(folder):
    r = read_recording(folder / "session")
    phases = [f.phase for f in r.frames]
    assert phases[0] == "do_gesture" and {"positive", "negative", "release"} <= set(phases)
    assert sum(bool(e.gesture) for e in r.examples("pause")) == phases.count("positive")
    assert r.size == (640, 480) and r.lens.fx == 575.8


def test_learning_from_the_recording_gives_the_same_forest_and_goes_on(folder, tmp_path, capsys):
    train = ("train", "--gesture", "pause", "--recording", folder / "session")
    assert run(capsys, *train, tmp_path / "again.npz")[0] == 0
    assert run(capsys, *train, tmp_path / "more.npz", "--resume", folder / "pause.npz")[0] == 0
    a, b, more = (np.load(path) for path in (folder / "pause.npz", tmp_path / "again.npz", tmp_path / "more.npz"))
    for name in set(a.files) - {"description", "digest"}:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)
    one, two = (json.loads(str(d["description"])) for d in (a, b))
    assert one["threshold"] == two["threshold"] and more["seen"].sum() > a["seen"].sum()


def test_run_writes_json_lines_and_osc(folder, capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(5)
        osc = f"127.0.0.1:{receiver.getsockname()[1]}"
        given = ("--source", folder / "session", "--threshold", "2", "--hold", "0.1", "--osc", osc)
        code, out, err = run(capsys, "run", folder / "pause.npz", *given)
        assert code == 0, err
        data = receiver.recv(2048)
    lines = [json.loads(line) for line in out.splitlines()]
    assert lines and lines[0]["event"] == "start" and lines[0]["gesture"] == "pause"
    assert len(lines[0]["position"]) == 3 and 0.5 < lines[0]["position"][2] < 4
    assert data.startswith(b"#bundle\0") and b"/gesture/pause\0" in data and b"/wek/outputs\0" in data


def test_eval(folder, capsys):
    values = json.loads(run(capsys, "eval", folder / "pause.npz", folder / "session")[1])
    assert values["positives"] > 0 and values["ap_5cm"] > 0.5


def test_a_model_that_is_replaced_is_told_and_that_of_another_gesture_refused(folder, tmp_path, capsys):
    model = shutil.copy(folder / "pause.npz", tmp_path / "pause.npz")
    before, train = model.read_bytes(), ("train", model, "--recording", folder / "session", "--gesture")
    code, _, err = run(capsys, *train, "wave")
    assert code == 2 and "is the model of pause, not of wave" in err and model.read_bytes() == before
    code, _, err = run(capsys, *train, "pause")
    assert code == 0 and "holds a model of pause already, which will be replaced" in err and f"--resume {model}" in err
    assert "will be replaced" not in run(capsys, *train, "pause", "--resume", model)[2]
    model.write_bytes(before[:2000])
    assert "damaged" in run(capsys, *train, "pause")[2]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ("run BROKEN", "damaged"),
        ("run none.npz", "does not exist"),
        ("run MODEL --source nowhere", "no depth source"),
        ("run MODEL --osc here --threshold 1", "HOST:PORT"),
        ("run MODEL MODEL --threshold 1 --source SESSION", "same gesture"),
        ("run MODEL --adaptation-rate 0", "--adaptation-rate"),
        ("run MODEL --source realsense --threshold 1", "RealSense"),
        ("train x.npz --gesture tee --recording SESSION", "no gesture 'tee'"),
        ("train x.npz --gesture tee --resume MODEL", "not of tee"),
        ("train x.npz --gesture pause --recording SESSION --record r", "--record is"),
        ("train x --gesture tee", ".npz"),
        ("train r.npz --gesture fly", "cannot do"),
    ],
)
def test_bad_input_ends_in_a_sentence(folder, tmp_path, monkeypatch, capsys, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.npz").write_bytes((folder / "pause.npz").read_bytes()[:2000])
    places = {"BROKEN": "broken.npz", "MODEL": folder / "pause.npz", "SESSION": folder / "session"}
    code, _, err = run(capsys, *(places.get(a, a) for a in arguments.split()))
    assert code == 2 and sentence in err and "Traceback" not in err, err


def blank(depth_mm, frames=60):
    """A camera that sees one depth everywhere."""

    times = iter(range(frames))
    picture = np.full((64, 64), depth_mm, np.uint16)

    def take(phase):
        k = next(times, None)
        return None if k is None else Taken(0.1 * k, picture, None)

    return GestureSource("blank", DepthLens(100, 100, 31.5, 31.5), (64, 64), take)


@pytest.mark.parametrize("depth_mm", [0, 8000])
def test_nothing_within_reach_is_said(depth_mm):

    settings = SessionSettings(do_gesture_s=1.0, positive_s=2.0, release_s=0.2, negative_s=1.0, rounds=2)
    with pytest.raises(InputError, match="none had depth between 0.5 and 4 m in the box"):
        run_session(Teaching(blank(depth_mm), "tee", settings))
    model, said, seen = GestureModel("tee", Learner.new(np.random.default_rng(0)), 1.0), [], []
    with pytest.raises(EvidenceError, match="blank: no frame has depth between 0.5 and 4 m"):
        for watched in watch(Watching(blank(depth_mm), [model]), said.append):
            seen.append(watched)
    assert len(seen) == 60 and not any(w.events for w in seen)
    assert len(said) == 1 and "between 0.5 and 4 m" in said[0]


def test_recordings_without_a_usable_gesture_are_refused(tmp_path, capsys):

    writer = SessionWriter(tmp_path / "far", ["tee"], DepthLens(100, 100, 31.5, 31.5), (64, 64))
    for k in range(6):
        picture = np.full((64, 64), 8000 if k % 2 else 2000, np.uint16)
        writer.add(0.1 * k, picture, "positive" if k % 2 else "negative", k + 1, k % 2, (32.0, 32.0))
    writer.close()
    arguments = ["train", tmp_path / "m.npz", "--gesture", "tee", "--recording", tmp_path / "far"]
    assert "no frame of 'tee' with depth between 0.5 and 4 m" in run(capsys, *arguments)[2]
    assert not (tmp_path / "m.npz").exists()


def test_a_frame_as_lines_for_listeners():
    frame = Watched(1.5, [Localisation(1, 3.0, 4.0, 12.0, None)], [Event(1, 3.0, 4.0, 12.0, None, "start", 1.5)])
    scores, event = map(json.loads, gesture_lines(frame, ["tee"]))
    assert scores == {"time": 1.5, "scores": {"tee": 12.0}} and event["event"] == "start"


def test_listeners_of_a_page_elsewhere_are_refused_and_silent_ones_cost_no_threads():
    out = SocketListeners(0)
    held = [socket.create_connection(("127.0.0.1", out.port), timeout=HANG_S) for _ in range(300)]
    threads = threading.active_count()
    with connect(f"ws://127.0.0.1:{out.port}") as listener:
        assert threading.active_count() - threads <= 2
        while not out.server.listeners:  # the listener is entered by another thread
            time.sleep(0.01)
        out.post("news")
        assert listener.recv(timeout=HANG_S) == "news"
    for s in held:
        s.close()
    with pytest.raises(Exception, match="403|rejected"):
        connect(f"ws://127.0.0.1:{out.port}", origin="https://example.org")
    out.close()
