"""Cameras as sources: motion JPEG as devices and phones send it, files at their own pace, and what cannot be opened."""

import base64
import contextlib
import re
import socket
import threading
from hashlib import md5
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np
import pytest

from hypose.errors import InputError
from hypose.io.videos import camera_sources
from hypose.io.videos.camera_sources import CameraImage, StreamEnded, open_camera

SIZE = (64, 48)


def jpeg(grey, size=SIZE):
    return cv2.imencode(".jpg", np.full((size[1], size[0], 3), grey, np.uint8))[1].tobytes()


PICTURES = [jpeg(40 * n + 20) for n in range(5)]


def part(data, *head, boundary=b"--frame"):
    return (
        boundary + b"\r\nContent-Type: image/jpeg\r\n" + b"".join(h + b"\r\n" for h in head) + b"\r\n" + data + b"\r\n"
    )


@contextlib.contextmanager
def server(body, kind="multipart/x-mixed-replace; boundary=frame", secret=None, extra=(), asks=None):
    """An address that answers every request with the bytes, and then ends the connection. secret: the Authorization
    that is let in, or says which; asks: with which header the others are sent away."""
    let_in = secret if callable(secret) else lambda header: header == secret

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            if secret is not None and not let_in(self.headers["Authorization"] or ""):
                self.send_response(401)
                if asks is not None:
                    self.send_header("WWW-Authenticate", asks)
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            self.send_response(200)
            self.send_header("Content-Type", kind)
            for name, value in extra:
                self.send_header(name, value)
            self.end_headers()
            with contextlib.suppress(OSError):
                self.wfile.write(body)

        def log_message(self, format, *args):
            pass

    listening = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    listening.daemon_threads = True
    thread = threading.Thread(target=listening.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{listening.server_port}/video"
    finally:
        listening.shutdown()
        listening.server_close()
        thread.join()


def all_of(address):
    """The shots of a stream, and the sentence with which it ends."""
    source, shots = open_camera(address, 30.0, SIZE), []
    assert source.live
    try:
        while True:
            shots.append(source.read())
    except StreamEnded as end:
        return shots, str(end)
    finally:
        source.close()


def grey(shot):
    picture = shot.picture()
    assert picture is not None and picture.shape == (SIZE[1], SIZE[0], 3)
    return float(picture.mean())


GREYS = pytest.approx([20, 60, 100, 140, 180], abs=1)

# ---- motion JPEG ----


@pytest.mark.parametrize("length", [True, False])
@pytest.mark.parametrize(
    "kind",
    [
        "multipart/x-mixed-replace; boundary=frame",
        'Multipart/X-Mixed-Replace;boundary="frame"; charset=utf-8',
        "multipart/x-mixed-replace; boundary=--frame",
    ],
)
def test_every_picture_of_a_stream_comes_with_and_without_its_length(length, kind):
    heads = [[b"Content-Length: %d" % len(p)] if length else [] for p in PICTURES]
    body = b"\r\n" + b"".join(part(p, *h) for p, h in zip(PICTURES, heads, strict=True)) + b"--frame--\r\n"
    with server(body, kind) as address:
        shots, end = all_of(address)
    assert [grey(s) for s in shots] == GREYS
    assert [s.data for s in shots] == PICTURES  # not a byte more or fewer
    assert end.startswith("The stream http://127.0.0.1") and "broke off" in end
    assert all(a.arrival <= b.arrival and a.stamp is None for a, b in zip(shots, shots[1:], strict=False))


def test_the_time_that_a_camera_tells_is_its_stamp_and_nonsense_is_none():
    reported = [b"12.5", b"12.533333", b"nan", b"inf", b"today"]
    body = b"".join(part(p, b"X-Timestamp: " + t) for p, t in zip(PICTURES, reported, strict=True)) + b"--frame--\r\n"
    with server(body) as address:
        shots, _ = all_of(address)
    assert [s.stamp for s in shots] == [12.5, 12.533333, None, None, None]


def test_a_stream_that_breaks_off_within_a_picture_has_ended():
    half = PICTURES[1][: len(PICTURES[1]) // 2]
    whole = part(PICTURES[0], b"Content-Length: %d" % len(PICTURES[0]))
    for cut in (
        whole + b"--frame\r\nContent-Length: %d\r\n\r\n" % len(PICTURES[1]) + half,
        whole + part(half)[:-2],
        whole + b"--frame\r\nContent-Length: 99999999999\r\n\r\n",
        whole + b"--frame\r\nContent-Length: many\r\n\r\n",
        whole + b"--frame\r\n" + b"X-More: 1\r\n" * 100,
    ):
        with server(cut) as address:
            shots, end = all_of(address)
        assert len(shots) == 1 and "broke off" in end and end.count("\n") == 0


def test_name_and_password_of_the_address_are_sent_and_never_shown():
    secret = "Basic " + base64.b64encode(b"admin:p@ss/w").decode()
    body = b"".join(part(p) for p in PICTURES) + b"--frame--\r\n"
    with server(body, secret=secret) as address:
        open_address = address.replace("://", "://admin:p%40ss%2Fw@")
        shots, end = all_of(open_address)
        assert len(shots) == 5 and "p%40" not in end and "admin:...@127.0.0.1" in end
        with pytest.raises(InputError) as refused:
            open_camera(address.replace("://", "://admin:wrongsecret@"), 30.0, SIZE)
    assert "wrongsecret" not in str(refused.value) and "asks for another name or password" in str(refused.value)


def test_a_camera_that_asks_for_a_digest_of_the_password_gets_one():
    body, asked = b"".join(part(p) for p in PICTURES) + b"--frame--\r\n", []

    def answered(header):
        asked.append(header)
        if not header.startswith("Digest "):
            return False
        reported = dict(re.findall(r'(\w+)="([^"]*)"', header))
        first, second = (md5(t.encode()).hexdigest() for t in ("admin:room:p@ss", f"GET:{reported['uri']}"))
        return reported["response"] == md5(f"{first}:abc:{second}".encode()).hexdigest()

    with server(body, secret=answered, asks='Digest realm="room", nonce="abc"') as address:
        shots, _ = all_of(address.replace("://", "://admin:p%40ss@") + "?size=1")
        assert len(shots) == 5 and asked[-1].startswith('Digest username="admin"')
        with pytest.raises(InputError, match="another name or password|digest auth failed"):
            open_camera(address.replace("://", "://admin:wrong@"), 30.0, SIZE)


@pytest.mark.parametrize("secret", ["pa/ss", "pa#ss", "pa?ss", "p@ss", "[pass", "pa ss", "pass"])
def test_no_password_is_shown_however_it_is_written(secret):
    with pytest.raises(InputError) as refused:
        open_camera(f"http://admin:{secret}@127.0.0.1:1/video", 30.0, SIZE)
    sentence = str(refused.value)
    assert secret not in sentence and "ss" not in sentence.replace("address", "").replace("passwords", "")
    assert "check the address" in sentence


@pytest.mark.parametrize(
    ("body", "kind", "sentence"),
    [
        (b"<html>", "text/html; charset=utf-8", r"is text/html, and motion JPEG .* is needed"),
        (b"", "", "is of no known kind"),
    ],
)
def test_what_is_no_motion_jpeg_says_what_it_is(body, kind, sentence):
    with server(body, kind) as address, pytest.raises(InputError, match=sentence):
        open_camera(address, 30.0, SIZE)


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.mark.parametrize(
    ("address", "sentence"),
    [
        *((a, "The stream http://.*check the address") for a in ("http://127.0.0.1:{}/v", "http://", "http://[::1/v")),
        ("http://127.0.0.1:port/v", "The stream http://.*check the address"),
        ("rtsp://me:secret@127.0.0.1:{}/s", r"The stream rtsp://me:\.\.\.@127.* cannot be opened"),
        ("97", "Camera 97 of this computer cannot be opened"),
        ("nothing.mp4", r"There is no file nothing\.mp4"),
        ("²", "There is no file ²"),
    ],
)
def test_a_camera_that_is_not_there_is_one_sentence(address, sentence):
    with pytest.raises(InputError, match=f"^[^\n]*{sentence}[^\n]*$"):
        open_camera(address.format(free_port()), 30.0, SIZE)


# ---- pictures ----


def test_a_damaged_picture_is_none():
    for data in (b"", b"no picture", PICTURES[0][:40], b"\xff\xd8\xff", b"\xff\xd8" + b"\xff\xc0\x00\x02" * 3):
        assert CameraImage(0.0, None, data).picture() is None
        assert CameraImage(0.0, None, data).picture((8, 8)) is None


@pytest.mark.parametrize("size", [(1920, 1080), (641, 479), (64, 48), (1000, 333)])
@pytest.mark.parametrize("least", [(640, 480), (320, 240), (100, 30), (17, 13), (2000, 2000)])
def test_a_picture_is_decoded_as_small_as_may_be_and_never_smaller(size, least):
    picture = CameraImage(0.0, None, jpeg(99, size)).picture(least)
    assert picture is not None
    h, w = picture.shape[:2]
    assert w >= min(least[0], size[0]) and h >= min(least[1], size[1])
    # half of it would be too small, unless it is an eighth already
    n = round(size[0] / w)
    assert n == 8 or size[0] < 2 * n * least[0] or size[1] < 2 * n * least[1]


# ---- files ----


class Clock:
    """Passes only while something waits, or works."""

    def __init__(self):
        self.now = 50.0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        assert seconds > 0
        self.now += seconds


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(camera_sources, "time", clock)
    return clock


@pytest.fixture
def folder(tmp_path):
    for n in range(10):
        cv2.imwrite(str(tmp_path / f"{n}.png"), np.full((48, 64, 3), 20 * n, np.uint8))
    return tmp_path


def played(path, rate, clock, work=0.0):
    source, out = open_camera(str(path), rate, SIZE, 50.5), []
    assert not source.live
    with contextlib.suppress(StreamEnded):
        while True:
            shot = source.read()
            out.append((round(grey(shot) / 20), shot.stamp, shot.arrival))
            clock.now += work
    source.close()
    return out


def test_who_is_too_slow_misses_pictures_as_with_a_camera(folder, clock):
    out = played(folder, 10.0, clock, work=0.25)
    numbers = [n for n, _, _ in out]
    assert numbers[:3] == [0, 2, 5] and numbers[-1] == 9 and len(set(numbers)) == len(numbers)
    assert all(s == pytest.approx(50.5 + n / 10) and a - s < 0.1 for n, s, a in out[:-1])


def test_a_file_that_is_over_says_so(folder, clock):
    source = open_camera(str(folder), 10.0, SIZE, 50.0)
    clock.now = 500.0
    assert grey(source.read()) == 180  # the last one stays until it has been seen
    with pytest.raises(StreamEnded, match="is over"):
        source.read()


def test_a_film_begins_again_and_all_cameras_with_it(folder, clock):
    source = open_camera(str(folder), 10.0, SIZE, 50.5, 1.0)
    shots = [source.read() for _ in range(25)]
    assert [round(grey(s) / 20) for s in shots] == [n % 10 for n in range(25)]
    assert [s.stamp for s in shots] == pytest.approx([50.5 + n / 10 for n in range(25)])
    assert [s.arrival for s in shots] == pytest.approx([s.stamp for s in shots])  # at their pace
    clock.now += 3.35  # what is missed is missed in later rounds, too
    shot = source.read()
    assert shot.stamp == pytest.approx(50.5 + 5.7) and round(grey(shot) / 20) == 7
