"""`hypose warm-up`: what it compiles is not compiled again."""

import pytest

from hypose.compute import compiled, warming
from hypose.compute.warming import TRACKING_KERNELS, kept, warm_up


@pytest.mark.slow
def test_nothing_is_left_to_compile_after_it(hypose, monkeypatch):
    had = kept(*TRACKING_KERNELS, "monocular", "depth")
    code, out, _ = hypose("warm-up")
    assert code == 0 and out.startswith("All of it had been compiled." if had else "Compiled; kept in ")
    began = []
    monkeypatch.setattr(warming, "_run", lambda parts: began.extend(parts))
    warm_up(load=False)
    assert not began
    assert hypose("warm-up")[1].startswith("All of it had been compiled.")


def test_without_a_place_one_sentence(hypose, monkeypatch):
    monkeypatch.setattr(compiled, "cache_folder", lambda: None)
    code, _, err = hypose("warm-up")
    assert code == 2 and "name a folder with HYPOSE_CACHE_DIR." in " ".join(err.split())


def test_what_cannot_be_kept_is_not_called_kept(hypose, monkeypatch):
    monkeypatch.setattr(warming, "warm_up", lambda *_, **__: 0.0)
    monkeypatch.setattr(warming, "kept", lambda *_: False)
    monkeypatch.setattr("hypose.app.jobs.job.run_job", lambda *_: None)
    code, out, err = hypose("warm-up")
    assert code == 2 and "could not all be kept in" in " ".join(err.split()) and "Compiled" not in out
