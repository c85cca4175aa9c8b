"""Live fusion over the wire: what simulated sensors send, what is recorded of it, and what is refused."""

import json

import numpy as np
import pytest

from hypose.app.studio.catalog import Catalog
from hypose.app.studio.job_kinds import plan_job
from hypose.io.sensors.skeleton_files import read_skeletons
from tests.app.studio.conftest import until


def start(socket, **more):
    socket.send(json.dumps({"t": "start", "udp": 0, "ws": 0, **more}))


def test_simulated_sensors_are_fused_recorded_and_told_where_they_stand(own_studio):
    with own_studio.socket("/ws/fuse") as socket:
        assert until(socket, "hello")["running"] is False
        start(socket, simulated=2, record=True, osc="127.0.0.1:9")
        running = until(socket, "hello")["running"]
        assert running["simulated"] and running["record"] == "live/live" and running["osc"] == "127.0.0.1:9"
        while len([s for s in until(socket, "status")["sensors"] if s["place"]]) < 2:
            pass
        message = until(socket, "status")
        places = [np.array(s["place"]) for s in message["sensors"]]
        np.testing.assert_allclose([p[:3, :3] @ p[:3, :3].T for p in places], [np.eye(3)] * 2, atol=1e-3)
        # they stand 70 degrees apart on a circle of 2.5 m around the person
        apart = np.linalg.norm(places[0][:3, 3] - places[1][:3, 3])
        assert abs(apart - 2 * 2.5 * np.sin(np.radians(35))) < 0.25
        while not until(socket, "frame")["people"]:
            pass
        socket.send('{"t": "stop"}')
        assert until(socket, "said")["text"] == "Recorded as live/live."
        until(socket, "hello", lambda m: m["running"] is False)
    state = own_studio.get("/api/state")
    assert [s["name"] for s in state["skeletons"]] == ["live"]
    assert len(read_skeletons(own_studio.studio.catalog.root / "live" / "live").streams) == 2
    catalog = Catalog(own_studio.studio.catalog.root)
    made = plan_job("fuse", {"skeletons": state["skeletons"][0]["id"]}, catalog)
    assert made.arguments[0] == "fuse" and made.result


@pytest.mark.parametrize(
    "wrong",
    [
        {"simulated": 5},
        {"simulated": True},
        {"osc": "nowhere"},
        {"osc": 3},
        {"osc": "127.0.0.1:0"},
        {"osc": [], "record": True},
        {"udp": 70000},
    ],
)
def test_what_cannot_be_started_is_refused_in_a_sentence(own_studio, wrong):
    with own_studio.socket("/ws/fuse") as socket:
        start(socket, **wrong)
        assert until(socket, "error")["error"].endswith(".")
        assert own_studio.studio.fusion.hello()["running"] is False
    assert not (own_studio.studio.catalog.root / "live").exists()
