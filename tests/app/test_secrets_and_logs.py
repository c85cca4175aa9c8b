"""Secrets are compared safely, and logs of servers do not grow."""

import logging

from hypose.app.live.servers import Folded, same_secret, shows_secret


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
