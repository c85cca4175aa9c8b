"""One result of several people: whose it is, and what is said when it is somebody else's."""

from unittest.mock import Mock

import pytest

from hypose.calibration.findings import INVALID, REVIEW, Finding
from hypose.pipeline.run import PeopleResult, TrackResult
from hypose.pipeline.track import track_one_of
from hypose.pipeline.track_management import KnownPerson
from hypose.pipeline.track_options import TrackOptions

ANNA = KnownPerson("Anna", place=(1.0, 2.5), time=0.5)


def found(name, monkeypatch, wanted, looked=()):
    one = TrackResult(None, None, True, (), findings=(Finding("fault", (), "a fault"),), name=name)  # type: ignore[arg-type]
    monkeypatch.setattr(
        "hypose.pipeline.track.track_people", Mock(return_value=PeopleResult((one,), True, (), 1, looked))
    )
    return track_one_of(None, 25.0, TrackOptions(), wanted=wanted)  # type: ignore[arg-type]


def test_who_is_found_in_place_of_the_one_at_a_place_is_not_to_be_trusted(monkeypatch):
    out = found("person-1", monkeypatch, [ANNA])
    assert [f.kind for f in out.findings if f.fault] == ["fault", "other person"]
    assert "no person was found who is Anna at [1, 2.5] m, 0.5 s from the first frame" in out.findings[-1].text


@pytest.mark.parametrize(
    ("kind", "fault", "reported"), [("mirrored", True, False), ("floor", True, True), ("blank", False, True)]
)
def test_nobody_else_is_told_where_cameras_make_one_person_two(monkeypatch, kind, fault, reported):
    out = found(
        "person-1", monkeypatch, [], (Finding(kind, (), "wrong", "correct it", 1.0, INVALID if fault else REVIEW),)
    )
    assert any(f.kind == "other people" for f in out.findings) == reported
