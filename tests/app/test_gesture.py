"""`hypose gesture`: a session of the simulated person, learned, watched, exported; what is wrong is named."""

import contextlib
import json
import socket
import threading

import numpy as np
import pytest

from hypose.app.cli import run_cli
from hypose.app.live.gesture_sources import open_source
from hypose.errors import EvidenceError, InputError
from hypose.gestures.forest import ForestSettings
from hypose.gestures.localise import LocaliseSettings
from hypose.gestures.model import GestureModel
from hypose.gestures.online import Learner
from hypose.pipeline.gesture_files import SessionWriter, read_recording, save_model
from tests.conftest import HANG_S


def hypose(*arguments):
    with pytest.raises(SystemExit) as stopped:
        run_cli([str(a) for a in arguments])
    assert stopped.value.code in (None, 0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A session of a few frames (phases shortened) recorded and learned once."""
    from hypose.app.jobs.gesture_job import new_learner, run_session
    from hypose.gestures.trainer import SessionSettings

    root = tmp_path_factory.mktemp("gesture")
    source = open_source("simulated:1", "pause", 3)
    settings = SessionSettings(do_gesture_s=1.0, positive_s=2.0, release_s=0.2, negative_s=1.5, rounds=2)
    model = run_session(source, "pause", new_learner(0), settings, record=root / "session", say=lambda text: None)
    save_model(model, root / "pause.npz")
    return root


def test_a_session_is_recorded_with_its_phases(folder):
    r = read_recording(folder / "session")
    phases = [f.phase for f in r.frames]
    assert phases[0] == "do_gesture" and {"positive", "negative", "release"} <= set(phases)
    assert sum(bool(e.gesture) for e in r.examples("pause")) == phases.count("positive")
    assert r.size == (640, 480) and r.lens.fx == 575.8


def test_learning_from_the_recording_gives_the_same_forest(folder, tmp_path):
    hypose("gesture", "train", tmp_path / "again.npz", "--gesture", "pause", "--recording", folder / "session")
    with np.load(folder / "pause.npz") as a, np.load(tmp_path / "again.npz") as b:
        for name in set(a.files) - {"description"}:
            np.testing.assert_array_equal(a[name], b[name], err_msg=name)
        one, two = (json.loads(str(d["description"])) for d in (a, b))
        assert one["thresholds"] == two["thresholds"]


def test_run_writes_json_lines_and_osc(folder, capsys):
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", 0))
    receiver.settimeout(5)
    port = receiver.getsockname()[1]
    arguments = ["--source", folder / "session", "--threshold", "2", "--hold", "0.1", "--osc", f"127.0.0.1:{port}"]
    hypose("gesture", "run", folder / "pause.npz", *arguments)
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines and lines[0]["event"] == "start" and lines[0]["gesture"] == "pause"
    assert len(lines[0]["position"]) == 3 and 0.5 < lines[0]["position"][2] < 4
    data = receiver.recv(2048)
    receiver.close()
    assert data.startswith(b"#bundle\0") and b"/gesture/pause\0" in data and b"/wek/outputs\0" in data


def test_eval(folder, capsys):
    hypose("gesture", "eval", folder / "pause.npz", folder / "session")
    values = json.loads(capsys.readouterr().out)
    assert values["positives"] > 0 and values["ap_5cm"] > 0.5


def test_growing_goes_on(folder, tmp_path):
    session = folder / "session"
    hypose(
        "gesture",
        "train",
        tmp_path / "more.npz",
        "--gesture",
        "pause",
        "--recording",
        session,
        "--resume",
        folder / "pause.npz",
    )
    with np.load(folder / "pause.npz") as a, np.load(tmp_path / "more.npz") as b:
        assert b["seen"].sum() > a["seen"].sum()


def test_a_model_that_is_replaced_is_told_and_that_of_another_gesture_refused(folder, tmp_path, capsys):
    model = tmp_path / "pause.npz"
    train = "gesture", "train", model, "--gesture"
    hypose(*train, "pause", "--recording", folder / "session")
    assert "will be replaced" not in capsys.readouterr().err
    hypose(*train, "pause", "--recording", folder / "session")
    said = capsys.readouterr().err
    assert "holds a model of pause already, which will be replaced" in said and f"--resume {model}" in said
    hypose(*train, "pause", "--recording", folder / "session", "--resume", model)
    assert "will be replaced" not in capsys.readouterr().err
    before = model.read_bytes()
    assert "is the model of pause, not of wave" in refused(capsys, *train, "wave", "--recording", folder / "session")
    assert model.read_bytes() == before
    model.write_bytes(before[:2000])
    assert "no model that can be read" in refused(capsys, *train, "pause", "--recording", folder / "session")


def refused(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        run_cli([str(a) for a in arguments])
    assert stopped.value.code == 2
    text = capsys.readouterr().err
    assert "Traceback" not in text
    return " ".join(text.split())


def test_bad_input_ends_in_a_sentence(folder, tmp_path, capsys):
    model, session = folder / "pause.npz", folder / "session"
    broken = tmp_path / "broken.npz"
    broken.write_bytes(model.read_bytes()[:2000])
    assert "damaged" in refused(capsys, "gesture", "run", broken)
    assert "does not exist" in refused(capsys, "gesture", "run", tmp_path / "none.npz")
    assert "no depth source" in refused(capsys, "gesture", "run", model, "--source", "nowhere")
    assert "HOST:PORT" in refused(capsys, "gesture", "run", model, "--osc", "here", "--threshold", "1")
    assert "no such program" in refused(
        capsys, "gesture", "run", model, "--command", "nothing-here", "--threshold", "1"
    )
    assert "same gesture" in refused(capsys, "gesture", "run", model, model, "--threshold", "1", "--source", session)
    assert "--adaptation-rate" in refused(capsys, "gesture", "run", model, "--adaptation-rate", "0")
    assert "no gesture 'tee'" in refused(
        capsys, "gesture", "train", tmp_path / "x.npz", "--gesture", "tee", "--recording", session
    )
    assert "not of tee" in refused(
        capsys, "gesture", "train", tmp_path / "x.npz", "--gesture", "tee", "--resume", model
    )
    two = ["gesture", "train", tmp_path / "x.npz", "--gesture", "pause", "--recording", session]
    assert "--record is" in refused(capsys, *two, "--record", tmp_path / "r")
    assert ".npz" in refused(capsys, "gesture", "train", tmp_path / "x", "--gesture", "tee")
    assert "cannot do" in refused(capsys, "gesture", "record", tmp_path / "r", "--gesture", "fly")
    assert "RealSense" in refused(capsys, "gesture", "run", model, "--source", "realsense", "--threshold", "1")


def blank(depth_mm, frames=60):
    """A camera that sees one depth everywhere."""
    from hypose.app.live.gesture_sources import GestureSource, Taken
    from hypose.gestures.depth_pictures import DepthLens

    times = iter(range(frames))
    picture = np.full((64, 64), depth_mm, np.uint16)

    def take(phase):
        k = next(times, None)
        return None if k is None else Taken(0.1 * k, picture, None)

    return GestureSource("blank", DepthLens(100, 100, 31.5, 31.5), (64, 64), take)


@pytest.mark.parametrize("depth_mm", [0, 8000])
def test_nothing_within_reach_is_said(depth_mm):
    from hypose.app.jobs.gesture_job import new_learner, run_session, watch
    from hypose.gestures.events import EventSettings
    from hypose.gestures.trainer import SessionSettings

    settings = SessionSettings(do_gesture_s=1.0, positive_s=2.0, release_s=0.2, negative_s=1.0, rounds=2)
    with pytest.raises(InputError, match="none had depth between 0.5 and 4 m in the box"):
        run_session(blank(depth_mm), "tee", new_learner(0), settings, record=None, say=lambda text: None)
    learner, said = new_learner(0), []
    model = GestureModel(("tee",), learner.forest, (1.0,), LocaliseSettings(), learner)
    seen = []
    with pytest.raises(EvidenceError, match="blank: no frame has depth between 0.5 and 4 m"):
        for watched in watch(blank(depth_mm), [model], LocaliseSettings(), [EventSettings(1.0)], said.append):
            seen.append(watched)
    assert len(seen) == 60 and not any(w.events for w in seen)
    assert len(said) == 1 and "between 0.5 and 4 m" in said[0]


def test_recordings_without_a_usable_gesture_are_refused(tmp_path, capsys):
    from hypose.gestures.depth_pictures import DepthLens

    writer = SessionWriter(tmp_path / "far", ["tee"], DepthLens(100, 100, 31.5, 31.5), (64, 64))
    for k in range(6):
        picture = np.full((64, 64), 8000 if k % 2 else 2000, np.uint16)
        writer.add(0.1 * k, picture, "positive" if k % 2 else "negative", k + 1, k % 2, (32.0, 32.0))
    writer.close()
    arguments = ["gesture", "train", tmp_path / "m.npz", "--gesture", "tee", "--recording", tmp_path / "far"]
    assert "no frame of 'tee' with depth between 0.5 and 4 m" in refused(capsys, *arguments)
    assert not (tmp_path / "m.npz").exists()
    learner = Learner.new(np.random.default_rng(0), ForestSettings())
    save_model(GestureModel(("tee",), learner.forest, (1.0,), LocaliseSettings(), learner), tmp_path / "tee.npz")
    refusal = refused(capsys, "gesture", "eval", tmp_path / "tee.npz", tmp_path / "far")
    assert "no frame of 'tee' with depth between 0.5 and 4 m" in refusal


def test_websocket_listeners_get_scores_and_events():
    from websockets.sync.client import connect

    from hypose.app.jobs.gesture_job import Watched, WebSocketOut
    from hypose.gestures.events import Event
    from hypose.gestures.localise import Localisation

    out = WebSocketOut(0, ["tee"])
    frame = Watched(1.5, [Localisation(1, 3.0, 4.0, 12.0, None)], [Event("start", 1, 1.5, 3.0, 4.0, None, 12.0)])
    with connect(f"ws://127.0.0.1:{out.port}") as listener:
        for _ in range(30_000):  # the listener is entered by another thread
            out.send(frame)
            try:
                texts = [listener.recv(timeout=0.05) for _ in range(2)]
                break
            except TimeoutError:
                continue
        assert json.loads(texts[0]) == {"time": 1.5, "scores": {"tee": 12.0}}
        assert json.loads(texts[1])["event"] == "start"
    out.send(frame)  # the listener has left
    held = [socket.create_connection(("127.0.0.1", out.port), timeout=HANG_S) for _ in range(300)]
    threads = threading.active_count()
    with connect(f"ws://127.0.0.1:{out.port}") as listener:  # silent connections keep nobody out, and cost no threads
        assert threading.active_count() - threads <= 2
        for _ in range(30_000):
            out.send(frame)
            with contextlib.suppress(TimeoutError):
                assert json.loads(listener.recv(timeout=0.05))["time"] == 1.5
                break
        else:
            raise AssertionError("the listener hears nothing")
    for s in held:
        s.close()
    with pytest.raises(Exception, match="403|rejected"):
        connect(f"ws://127.0.0.1:{out.port}", origin="https://example.org")
    out.close()
