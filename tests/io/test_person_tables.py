"""What [[person]] tables may say: names are folders, beside files of everybody's results."""

from pathlib import Path

import pytest

from hypose.errors import InputError
from hypose.io.recordings.recording import Person, people_of_tables


def read(*tables):
    return people_of_tables(Path("here"), "recording.toml", tables)


def test_what_is_left_out_is_not_known():
    given = {"name": "J. Smith", "height": 2, "body": "b.npz", "place": [1, 2.5], "time": 3}
    assert read({}, given) == (
        Person("person-1"),
        Person("J. Smith", 2.0, Path("here/b.npz"), (1.0, 2.5), 3.0),
    )


@pytest.mark.parametrize("name", ["", "a/b", "..", "all", "7", "CON", "overlay.mp4", "report.html", "people.json"])
def test_a_name_that_is_no_folder_of_its_own_is_refused(name):
    with pytest.raises(InputError, match="names a folder"):
        read({"name": name})


@pytest.mark.parametrize("other", ["Anna B", "anna b", "Anna-B", "Anna.B"])
def test_names_that_files_cannot_tell_apart_are_refused(other):
    with pytest.raises(InputError, match="rename one"):
        read({"name": "Anna B"}, {"name": other})
    assert len(read({"name": "Anna B"}, {"name": "Anna C"})) == 2


@pytest.mark.parametrize("wrong", [{"name": 5}, {"height": "1.7"}, {"height": 17.0}, {"time": -1.0}, {"place": [1.0]}])
def test_what_cannot_be_is_refused(wrong):
    with pytest.raises(InputError, match="recording.toml, person"):
        read({"name": "anna"} | wrong)
