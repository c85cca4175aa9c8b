"""Motions equal byte for byte, archives that cannot hurt, checkpoints of the same run only, whole files or
none."""

import dataclasses
import io
import json
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hypose.body.default_body import human
from hypose.body.motion import Modes, Motion
from hypose.errors import InputError
from hypose.io.files import atomic_path
from hypose.io.motions.results import (
    _BODY_LAYOUT,
    Checkpoint,
    file_identity,
    load_body,
    load_joints_of_modes,
    load_modes,
    load_motion,
    provenance,
    provenance_identity,
    save_body,
    save_modes,
    save_motion,
    to_json,
)


def assert_same(a: Motion, b: Motion):
    for holder_a, holder_b in ((a, b), (a.skeleton, b.skeleton)):
        for field in dataclasses.fields(holder_a):
            x, y = getattr(holder_a, field.name), getattr(holder_b, field.name)
            if isinstance(x, np.ndarray):
                assert x.dtype == y.dtype and np.array_equal(x, y, equal_nan=x.dtype.kind == "f"), field.name
            elif field.name not in ("skeleton", "provenance"):
                assert x == y, field.name


# ---- motions -----------------------------------------------------------------------------------------------


def test_motion_round_trip(small_motion, tmp_path):
    save_motion(small_motion, tmp_path / "motion.npz")
    back = load_motion(tmp_path / "motion.npz")
    assert_same(small_motion, back)
    assert back.provenance == {"recipe": "test"}
    points_only = dataclasses.replace(small_motion, poses=None)
    save_motion(points_only, tmp_path / "points.npz")
    assert load_motion(tmp_path / "points.npz").poses is None


def test_rivals_are_kept_with_their_weights(small_motion, tmp_path):
    rivals = np.random.default_rng(1).normal(size=(60, 2, small_motion.skeleton.dof)).astype(np.float32)
    rivals[0, 1], weights = np.nan, np.full((60, 2), 0.2, np.float32)
    motion = dataclasses.replace(small_motion, rivals=rivals, rival_weights=weights)
    save_motion(motion, tmp_path / "motion.npz")
    assert_same(motion, load_motion(tmp_path / "motion.npz"))
    for wrong in ({"rivals": rivals[:, :1]}, {"rivals": rivals[1:]}, {"rival_weights": None}, {"rivals": None}):
        with pytest.raises(InputError, match="Motion.rival"):
            dataclasses.replace(motion, **wrong)


def test_same_motion_same_bytes(small_motion, tmp_path):
    """Whenever, wherever and by which command it was written; in any memory order."""
    record = provenance("hpf", 3, {"particles": np.int64(200)}, {}, {"seconds": 1.5})
    first = dataclasses.replace(small_motion, provenance=record)
    save_motion(first, tmp_path / "a.npz")
    record = provenance("hpf", 3, {"particles": 200}, {}, {"seconds": 9.0, "threads": 2})
    joints = np.asfortranarray(small_motion.joints)
    save_motion(dataclasses.replace(small_motion, provenance=record, joints=joints), tmp_path / "sub" / "b.npz")
    data = (tmp_path / "a.npz").read_bytes()
    assert data == (tmp_path / "sub" / "b.npz").read_bytes()
    assert b"seconds" not in data
    assert "run" not in load_motion(tmp_path / "a.npz").provenance
    save_motion(load_motion(tmp_path / "a.npz"), tmp_path / "c.npz")
    assert data == (tmp_path / "c.npz").read_bytes()


def test_motion_opens_with_plain_numpy(small_motion, tmp_path):
    save_motion(small_motion, tmp_path / "motion.npz")
    with np.load(tmp_path / "motion.npz", allow_pickle=False) as archive:
        assert np.array_equal(archive["joints"], small_motion.joints)
        assert tuple(archive["joint_names"]) == small_motion.skeleton.joint_names
        assert json.loads(str(archive["provenance"]))["provenance"] == {"recipe": "test"}


def entries(path):
    with zipfile.ZipFile(path) as archive:
        return {e.filename: archive.read(e) for e in archive.infolist()}


def rewrite(path, content, **options):
    with zipfile.ZipFile(path, "w", **options) as archive:
        for name, data in content.items():
            archive.writestr(name, data)


def npy(array, **options):
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(array), (1, 0), **options)
    return stream.getvalue()


def header(shape, descr="<f8"):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": descr, "fortran_order": False, "shape": shape})
    return stream.getvalue()


class Bomb:
    def __reduce__(self):
        return (Path("exploded").touch, ())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"times.npy": None}, r"times is missing"),
        ({"other.npy": npy([1.0])}, r"it holds the unknown array 'other'"),
        ({"../evil.npy": npy([1.0])}, r"it holds '\.\./evil\.npy', which is no array"),
        ({"readme.txt": b"x"}, r"it holds 'readme\.txt', which is no array"),
        ({"joints.npy": npy(np.array([Bomb()], dtype=object), allow_pickle=True)}, r"joints holds object"),
        ({"joints.npy": pickle.dumps(Bomb())}, r"is not a motion, or is damaged: .*magic string"),
        ({"joints.npy": b""}, r"is not a motion, or is damaged"),
        ({"joints.npy": header((10**9, 19, 3))}, r"joints of shape .* does not fit its 0 bytes"),
        ({"joints.npy": header((2**40, 2**40, 2**40))}, r"does not fit its 0 bytes"),
        ({"joints.npy": header((-5, 19, 3))}, r"joints has shape \(-5, 19, 3\)"),
        ({"joints.npy": npy(np.zeros((60, 19, 3), np.float32))}, r"joints is float32 with 3 dimensions"),
        ({"joints.npy": npy(np.zeros((60, 19)))}, r"joints is float64 with 2 dimensions"),
        ({"joints.npy": npy(np.zeros((59, 19, 3)))}, r"Motion\.joints has shape \(59, 19, 3\)"),
        ({"poses.npy": npy(np.zeros((60, 7)))}, r"Motion\.poses has shape \(60, 7\)"),
        ({"times.npy": npy(np.zeros(60))}, r"times do not increase"),
        ({"times.npy": npy(np.full(60, np.nan))}, r"times contains NaN"),
        ({"lost.npy": npy(np.zeros(60))}, r"lost is float64"),
        ({"parents.npy": npy(np.full(19, 25))}, r"Skeleton\.parents must hold -1 for the root"),
        ({"joint_of_dof.npy": npy(np.full(36, 99))}, r"joint_of_dof names joints that do not exist"),
        ({"axes.npy": npy(np.full((36, 3), np.nan))}, r"axes contains NaN"),
        ({"provenance.npy": npy(np.array("not json"))}, r"or is damaged: Expecting value"),
        ({"provenance.npy": npy(np.array('{"format": 99, "provenance": {}}'))}, r"it has format 99"),
        ({"provenance.npy": npy(np.array("[" * 100_000))}, r"or is damaged: maximum recursion"),
    ],
)
def test_hostile_or_damaged_motion(small_motion, tmp_path, monkeypatch, change, message):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "motion.npz"
    save_motion(small_motion, path)
    content = {k: v for k, v in (entries(path) | change).items() if v is not None}
    rewrite(path, content)
    with pytest.raises(InputError, match=message) as caught:
        load_motion(path)
    assert "motion.npz" in str(caught.value) and "give the motion.npz that hypose track wrote" in str(caught.value)
    assert not Path("exploded").exists()


def test_compressed_archives_are_refused_before_unpacking(small_motion, tmp_path):
    path = tmp_path / "motion.npz"
    for content in ({"cost.npy": header((30_000_000,)) + bytes(240_000_000)}, {"times.npy": npy(np.arange(9.0))}):
        rewrite(path, content, compression=zipfile.ZIP_DEFLATED)
        with pytest.raises(InputError, match=r"(cost|times)\.npy is compressed or encrypted; give the"):
            load_motion(path)


# ---- checkpoints -------------------------------------------------------------------------------------------


RUN = {"recipe": "hpf", "seed": 3, "settings": {"particles": 200}, "inputs": {"cam1": {"sha256": "ab" * 32}}}


def make_checkpoint(path, run=RUN):
    arrays = {"values": np.arange(12.0).reshape(3, 4), "lost": np.array([True, False]), "n": np.array(7)}
    Checkpoint(40, arrays, {"phase": "tracking"}, run).save(path)
    return arrays


def test_checkpoint_round_trip(tmp_path):
    arrays = make_checkpoint(tmp_path / "checkpoint.npz")
    back = Checkpoint.load(tmp_path / "checkpoint.npz", json.loads(json.dumps(RUN)))
    assert back.frame == 40 and back.meta == {"phase": "tracking"} and back.identity == RUN
    assert set(back.arrays) == set(arrays)
    for name, value in arrays.items():
        assert back.arrays[name].dtype == value.dtype and np.array_equal(back.arrays[name], value)
    before = (tmp_path / "checkpoint.npz").read_bytes()
    make_checkpoint(tmp_path / "checkpoint.npz")
    assert before == (tmp_path / "checkpoint.npz").read_bytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 4}, r"seed was 3 then and is 4 now"),
        ({"settings": {"particles": 100}}, r"settings\.particles was 200 then and is 100 now"),
        ({"settings": {}}, r"settings\.particles was given then and is not now"),
        ({"extra": 1}, r"extra was not given then and is now"),
        ({"inputs": {"cam1": {"sha256": "cd" * 32}}}, r"inputs\.cam1\.sha256 was \"abab.*\.\.\. then"),
    ],
)
def test_checkpoint_of_another_run_is_refused(tmp_path, change, message):
    make_checkpoint(tmp_path / "checkpoint.npz")
    with pytest.raises(InputError, match=message) as caught:
        Checkpoint.load(tmp_path / "checkpoint.npz", RUN | change)
    assert "belongs to another run" in str(caught.value)
    assert "run again without --resume to start from the first frame" in str(caught.value)


def test_damaged_checkpoint(tmp_path, small_motion):
    path = tmp_path / "checkpoint.npz"

    def refused(message):
        with pytest.raises(InputError, match=message):
            Checkpoint.load(path, RUN)

    refused(r"The checkpoint .* does not exist")
    path.write_bytes(b"PK nonsense")
    refused(r"is not a checkpoint, or is damaged")
    save_motion(small_motion, path)
    refused(r"is not a checkpoint")
    make_checkpoint(path)
    document = str(np.load(path)["checkpoint"]).replace('"format": 1', '"format": 2')
    rewrite(path, entries(path) | {"checkpoint.npy": npy(np.array(document))})
    refused(r"it has format 2, this version")


# ---- files -------------------------------------------------------------------------------------------------


def test_an_interrupted_write_leaves_the_old_file(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(KeyboardInterrupt), atomic_path(tmp_path / "a.txt") as temporary:
        assert temporary.parent == tmp_path and temporary.suffix == ".txt"
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert (tmp_path / "a.txt").read_text() == "old" and len(list(tmp_path.iterdir())) == 1


# ---- provenance --------------------------------------------------------------------------------------------


def test_provenance_is_json_and_names_everything(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"abc")
    record = provenance("hpf", 7, {"sigma": np.float64(0.5)}, {"cam1": tmp_path / "a.mp4"}, {"seconds": 2.0})
    back = json.loads(to_json(record))
    assert back["recipe"] == "hpf" and back["seed"] == 7 and back["settings"] == {"sigma": 0.5}
    assert set(back["versions"]) >= {"hypose", "python", "numpy", "numba", "opencv-python-headless"}
    assert back["versions"]["numpy"] == np.__version__
    assert back["inputs"]["cam1"] == {
        "name": "a.mp4",
        "bytes": 3,
        "sha256": "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad",
        "hashed": "all",
    }
    assert back["run"]["seconds"] == 2.0 and back["run"]["command"]
    assert "run" not in provenance_identity(record) and provenance_identity(record)["seed"] == 7


def test_folders_are_hashed_by_names_and_contents(tmp_path):
    folder = tmp_path / "pose"
    folder.mkdir()
    (folder / "1.json").write_text("a")
    (folder / "2.json").write_text("b")
    first = file_identity(folder)
    assert (first["files"], first["bytes"], first["hashed"]) == (2, 2, "all")
    (folder / "2.json").rename(folder / "3.json")
    second = file_identity(folder)["sha256"]
    (folder / "3.json").write_text("c")
    assert len({first["sha256"], second, file_identity(folder)["sha256"]}) == 3
    with pytest.raises(InputError, match=r"none does not exist"):
        file_identity(tmp_path / "none")


# ---- test bodies ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("bodies") / "body.npz"
    save_body(human(), path)
    return path


def spoil(path, to, **changes):
    """A copy of an archive with some arrays replaced (None: left out)."""
    arrays = entries(path) | {f"{k}.npy": v if v is None else npy(v, allow_pickle=True) for k, v in changes.items()}
    rewrite(to, {k: v for k, v in arrays.items() if v is not None})
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


@pytest.mark.parametrize("name", sorted(_BODY_LAYOUT))
def test_every_array_is_needed(saved, tmp_path, name):
    with pytest.raises(InputError, match=f"{name}.* is missing; give the results folder"):
        load_body(spoil(saved, tmp_path / "b.npz", **{name: None}))


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("coarse_faces", np.array([[0, 1, 99999]], np.int32), "refers to vertex"),
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
    assert "b.npz is not a body" in str(caught.value)


# ---- test modes ----------------------------------------------------------------------------------------------------
# modes.npz: read back as written, padded to the most modes, and refused when it is something else.


def some(t, k, seed=0, d=5, j=3):
    rng = np.random.default_rng(seed)
    weights = rng.random((t, k))
    return Modes(
        rng.normal(size=(t, k, d)),
        rng.normal(size=(t, k, j, 3)),
        weights / weights.sum(1, keepdims=True),
        rng.normal(size=(t, k)),
        rng.normal(size=(t, k, d, d)).astype(np.float32),
        rng.normal(size=(t, j, 3, 3)),
        rng.random((t, j)),
        np.full(t, k, dtype=np.int64),
    )


def test_read_back(tmp_path) -> None:
    modes = some(4, 2)
    save_modes(modes, tmp_path / "modes.npz")
    again = load_modes(tmp_path / "modes.npz")
    for name in ("poses", "joints", "weights", "costs", "covariances", "joint_covariance", "depth_sd", "alive"):
        np.testing.assert_array_equal(getattr(modes, name), getattr(again, name))
    assert len(again) == 4
    joints, weights = load_joints_of_modes(tmp_path / "modes.npz")
    np.testing.assert_array_equal(joints, modes.joints)
    np.testing.assert_array_equal(weights, modes.weights)


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "does not exist"), (b"", "is empty"), (b"no archive", "not a file of modes"),
     ({"x": np.zeros(3)}, "unknown array|is missing"),
     ({"joints": np.zeros((4, 2, 3, 3)), "weights": np.zeros((4, 3))}, "do not belong together|is missing")],
)  # fmt: skip
def test_other_files_are_refused(tmp_path, content, message):
    path = tmp_path / "modes.npz"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        np.savez(path, **content)
    for load in (load_modes, load_joints_of_modes):
        with pytest.raises(InputError, match=f"modes.npz.*({message})"):
            load(path)
