"""A studio that serves a small recording with its result, as a server of its own in this process."""

import contextlib
import json
import shutil
import threading
import urllib.error
import urllib.request

import pytest
from websockets.sync.client import connect

from hypose.app.studio.server import Studio, make_server, open_port
from tests import missing
from tests.app.studio.browser import build
from tests.conftest import HANG_S


class Client:
    """Asks a studio as a page would, and as no page may."""

    def __init__(self, studio, port):
        self.studio, self.port = studio, port
        self.address = f"http://127.0.0.1:{port}/"

    def ask(self, path, value=None, *, method=None, headers=None, data=None):
        """(status, headers, body bytes)."""
        body = json.dumps(value).encode() if value is not None else data
        method = method or ("GET" if body is None else "POST")
        request = urllib.request.Request(self.address + path.lstrip("/"), body, headers or {}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=HANG_S) as answer:
                return answer.status, answer.headers, answer.read()
        except urllib.error.HTTPError as error:
            return error.code, error.headers, error.read()

    def get(self, path, value=None, status=200, **more):
        """The JSON of an answer with this status."""
        got, _, body = self.ask(path, value, **more)
        assert got == status, (got, body[:500])
        return json.loads(body)

    @property
    def recording(self):
        """The id of the first recording."""
        return self.get("/api/state")["recordings"][0]["id"]

    @property
    def result(self):
        """The id of the first result."""
        return self.get("/api/state")["results"][0]["id"]

    def socket(self, path, **more):
        return connect(f"ws://127.0.0.1:{self.port}{path}", compression=None, max_size=None, **more)


def until(socket, kind, wanted=lambda message: True):
    """The next message of a kind that is wanted; an error that is not asked for fails."""
    while True:
        message = json.loads(socket.recv(HANG_S))
        assert message["t"] != "error" or kind == "error", message
        if message["t"] == kind and wanted(message):
            return message


@contextlib.contextmanager
def serving(root, **options):
    studio, port = Studio(root, **options), open_port("127.0.0.1", 0)
    server = make_server(studio)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [port]}, daemon=True)
    thread.start()
    try:
        yield Client(studio, port.getsockname()[1])
    finally:
        server.should_exit = True
        thread.join(HANG_S)
        assert not thread.is_alive()


@pytest.fixture(scope="session")
def served(tiny, tracked, tmp_path_factory):
    """A folder with the recording `walk` and its result `default`; read only."""
    root = tmp_path_factory.mktemp("served")
    shutil.copytree(tiny, root / "walk")
    shutil.copytree(tracked, root / "walk" / "results" / "default")
    return root


@pytest.fixture
def folder(served, tmp_path):
    """A copy of the served folder that a test may change."""
    return shutil.copytree(served, tmp_path / "root")


@pytest.fixture(scope="module")
def studio(served):
    """A running studio on the served folder, for tests that change nothing."""
    with serving(served) as client:
        yield client


@pytest.fixture
def own_studio(folder):
    """A running studio on a folder of its own."""
    with serving(folder) as client:
        yield client


@pytest.fixture(scope="session")
def page():
    """The page is built, from the sources as they are."""
    builder = build()
    try:
        builder.build_page()
    except builder.PageError as error:
        missing.skip("the studio's page", f"make it possible to build it ({str(error).replace(';', ',')})")
