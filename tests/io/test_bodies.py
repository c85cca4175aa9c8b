import io
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from hypose.body.ready_bodies import human
from hypose.errors import InputError
from hypose.io.motions.results import _ARRAYS, load_body, save_body


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("bodies") / "body.npz"
    save_body(human(), path)
    return path


def spoil(path, to, **changes):
    """A copy of an archive with some arrays replaced (None: left out)."""
    with np.load(path) as data:
        arrays = {**{k: data[k] for k in data.files}, **changes}
    with zipfile.ZipFile(to, "w") as archive:
        for name, value in arrays.items():
            if value is not None:
                buffer = io.BytesIO()
                np.save(buffer, value, allow_pickle=True)
                archive.writestr(f"{name}.npy", buffer.getvalue())
    return to


def test_a_body_comes_back_whole(saved):
    a, b = human(), load_body(saved)
    assert a.name == b.name and a.skeleton.joint_names == b.skeleton.joint_names
    assert a.landmarks.names == b.landmarks.names
    q = np.full(a.skeleton.dof, 0.1)
    np.testing.assert_array_equal(a.skin(q), b.skin(q))
    np.testing.assert_array_equal(a.skin(q, a.fine), b.skin(q, b.fine))
    np.testing.assert_array_equal(a.landmark_points(q), b.landmark_points(q))
    np.testing.assert_array_equal(a.skeleton.lower, b.skeleton.lower)


def test_equal_bodies_give_equal_bytes(saved, tmp_path):
    save_body(load_body(saved), tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == saved.read_bytes()


def test_a_body_without_landmarks(tmp_path):
    from hypose.body.body import Landmarks

    bare = replace(human(), landmarks=Landmarks((), np.zeros(0, np.int64), np.zeros((0, 3))))
    save_body(bare, tmp_path / "b.npz")
    assert load_body(tmp_path / "b.npz").landmarks.names == ()


@pytest.mark.parametrize("name", sorted(_ARRAYS))
def test_every_array_is_needed(saved, tmp_path, name):
    with pytest.raises(InputError, match=f"{name}.* is missing; give the results folder"):
        load_body(spoil(saved, tmp_path / "b.npz", **{name: None}))


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("coarse_faces", np.array([[0, 1, 99999]], np.int32), "names vertices that do not exist"),
        ("fine_skin_index", np.full((3, 4), 77, np.int32), "names joints that do not exist"),
        ("landmark_joint", np.array([-1]), "names joints that do not exist"),
        ("coarse_vertices", np.full((3, 3), np.nan), "contains NaN"),
        ("lower", np.full(36, np.nan), "contains NaN"),
        ("parents", np.arange(19) + 5, "Skeleton.parents"),
        ("axes", np.array([object()]), "not allowed"),
        ("format", np.array(2), "format 2"),
        ("surprise", np.zeros(3), "unknown array 'surprise'"),
    ],
)
def test_damaged_and_hostile_bodies_are_named(saved, tmp_path, name, value, reason):
    with pytest.raises(InputError, match=reason) as caught:
        load_body(spoil(saved, tmp_path / "b.npz", **{name: value}))
    assert "b.npz is not a body of hypose" in str(caught.value)


def test_an_absent_body(tmp_path):
    with pytest.raises(InputError, match="does not exist; give the results folder"):
        load_body(tmp_path / "body.npz")
