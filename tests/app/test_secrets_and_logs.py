"""Secrets are compared safely, and logs of servers do not grow."""

import logging

from hypose.app.live.servers import quiet_logs, same_secret, shows_secret


def test_a_secret_is_compared_with_anything():
    assert same_secret("a-good-token", "a-good-token") and not same_secret("\udcff\ud800é", "a-good-token")
    assert shows_secret("x=1&token=s%C3%A9same", "", "sésame") and shows_secret("", "Bearer sésame", "sésame")
    assert not shows_secret("token=%ff%00", "Bearer \xff", "sésame")


def test_what_strangers_send_is_not_logged_and_bugs_are(caplog):
    quiet_logs()
    log = logging.getLogger("websockets.server")
    log.error("opening handshake failed", exc_info=ValueError("byte 0"))
    log.error("connection handler failed")
    assert [r.getMessage() for r in caplog.records] == ["connection handler failed"]
