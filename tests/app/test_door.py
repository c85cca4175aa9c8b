"""What the servers' door does with connections that say nothing, and with logs that would grow."""

import asyncio
import logging
import socket

import pytest

from hypose.app.live.door import Door, Folded, same_secret, shows_secret
from tests.conftest import HANG_S


class Echo(asyncio.Protocol):
    """Answers "known" and "stranger" as a request would be; "hold" is being answered until the connection ends."""

    def __init__(self, entrance):
        self.entrance = entrance

    def connection_made(self, transport):
        self.transport, self.held = transport, []

    def connection_lost(self, exc):
        for answering in self.held:
            answering.__exit__(None, None, None)

    def data_received(self, data):
        answering = self.entrance.answering(self.transport.get_extra_info("peername"), data != b"stranger")
        answering.__enter__()
        self.transport.write(data)
        if data == b"hold":
            self.held.append(answering)
        else:
            answering.__exit__(None, None, None)


def through(entrance, play):
    """Run play(connect) with a server behind the door; connect() gives (reader, writer)."""

    async def run():
        loop = asyncio.get_running_loop()
        server = await loop.create_server(
            entrance.letting_in(lambda: Echo(entrance)), "127.0.0.1", 0, backlog=entrance.backlog
        )
        port = server.sockets[0].getsockname()[1]
        writers = []

        async def connect():
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writers.append(writer)
            return reader, writer

        try:
            return await asyncio.wait_for(play(connect), HANG_S)
        finally:
            for writer in writers:
                writer.close()
            server.close()

    return asyncio.run(run())


async def ended(reader):
    """Whether the server has ended a connection."""
    try:
        return await reader.read(100) == b""
    except ConnectionResetError:
        return True


async def says(connection, text):
    connection[1].write(text)
    return await connection[0].read(100)


def test_a_silent_connection_is_ended_and_one_that_is_answered_is_not():
    async def play(connect):
        silent, held = await connect(), await connect()
        assert await says(held, b"hold") == b"hold"
        assert await ended(silent[0])
        await asyncio.sleep(0.3)
        assert await says(held, b"known") == b"known" and len(entrance) == 1

    entrance = Door(silent_s=0.1)
    through(entrance, play)


def test_a_newcomer_takes_the_place_of_who_was_silent_longest():
    async def play(connect):
        held = await connect()
        assert await says(held, b"hold") == b"hold"
        silent = [await connect() for _ in range(3)]
        assert await says(silent[0], b"stranger") == b"stranger"  # it has said something since
        newest = await connect()
        assert await says(newest, b"known") == b"known"
        assert await ended(silent[1][0]) and len(entrance) == 4
        for one in (held, silent[0], silent[2]):
            assert await says(one, b"known") == b"known"

    entrance = Door(most=4)
    through(entrance, play)


def test_with_all_places_in_use_a_newcomer_is_sent_away():
    async def play(connect):
        held = [await connect() for _ in range(3)]
        for one in held:
            assert await says(one, b"hold") == b"hold"
        assert await ended((await connect())[0])
        assert await says(held[0], b"known") == b"known"

    through(Door(most=3), play)


def test_who_takes_nothing_of_what_is_sent_is_ended():
    class Flood(Echo):
        def data_received(self, data):
            self.held.append(self.entrance.answering(self.transport.get_extra_info("peername"), True))
            self.held[-1].__enter__()
            self.transport.write(bytes(64 << 20))

    async def play(connect):
        _, writer = await connect()
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        writer.transport.pause_reading()
        writer.write(b"known")
        while not len(entrance):
            await asyncio.sleep(0.01)
        while len(entrance):
            await asyncio.sleep(0.01)

    entrance = Door(silent_s=0.1)
    usual = entrance.letting_in
    entrance.letting_in = lambda make: usual(lambda: Flood(entrance))
    through(entrance, play)


def test_a_connection_that_ended_while_it_sent_is_left_alone():
    class Answer(Echo):
        def data_received(self, data):
            self.transport.write(bytes(8 << 20))
            self.transport.close()

    async def play(connect):
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: wrong.append(context))
        reader, writer = await connect()
        writer.write(b"known")
        assert len(await reader.read(-1)) == 8 << 20
        await asyncio.sleep(0.3)

    wrong, entrance = [], Door(silent_s=0.1)
    usual = entrance.letting_in
    entrance.letting_in = lambda make: usual(lambda: Answer(entrance))
    through(entrance, play)
    assert wrong == []


def test_few_files_make_few_places(monkeypatch):
    resource = pytest.importorskip("resource")
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (80, 80))

    async def play(connect):
        for _ in range(40):
            await connect()
        newest = await connect()
        assert await says(newest, b"known") == b"known" and len(entrance) == 20

    entrance = Door()
    through(entrance, play)


def test_a_secret_is_compared_with_anything():
    assert same_secret("a-good-token", "a-good-token") and not same_secret("\udcff\ud800é", "a-good-token")
    assert shows_secret("x=1&token=s%C3%A9same", "", "sésame") and shows_secret("", "Bearer sésame", "sésame")
    assert not shows_secret("token=%ff%00", "Bearer \xff", "sésame")


def test_a_log_says_the_same_thing_once_a_minute_and_foreign_bytes_give_no_traceback():
    now, lines = [0.0], []

    class Keep(logging.Handler):
        def emit(self, record):
            lines.append(self.format(record))

    log = logging.Logger("server")
    log.addHandler(Keep())
    log.addFilter(Folded(lambda: now[0]))
    for n in range(1000):
        try:
            raise ValueError(f"byte {n}")
        except ValueError:
            log.exception("Invalid UTF-8 sequence received from client.")
            log.exception("Exception in callback <handle at 0x%x>\nhandle: %d", n, n)
    assert len(lines) == 2
    assert lines[0] == "Invalid UTF-8 sequence received from client. (ValueError: byte 0)"
    assert "Traceback" in lines[1]  # a bug of our own keeps it
    now[0] = 61.0
    log.warning("Invalid HTTP request received.")
    log.error("Invalid UTF-8 sequence received from client.", exc_info=ValueError("again"))
    assert lines[2:] == [
        "Invalid HTTP request received.",
        "Invalid UTF-8 sequence received from client. (ValueError: again) (999 more like it)",
    ]
