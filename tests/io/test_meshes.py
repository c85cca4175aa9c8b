"""Meshes of people from files, and what they become: units, axes, holes, parts, skins, body models, hostile files."""

import io
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from hypose.body.body import enclosed_volume
from hypose.body.default_body import JOINT_NAMES, human
from hypose.body.joint_names import MIXAMO, SMPL_JOINTS, renamed_body
from hypose.body.skin_weights import is_closed
from hypose.errors import InputError
from hypose.io.motions.animation import write_glb
from hypose.io.motions.meshes import PersonMesh, closed_surface, read_person
from hypose.pipeline.mesh_subject import rig_mesh
from hypose.tracking.start_search import known_pose

Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def t_pose() -> tuple[np.ndarray, np.ndarray]:
    body = human()
    return body.skin(known_pose(body, "t"), body.fine), body.fine.faces


def export(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    return path


@pytest.mark.parametrize("ending", ["obj", "ply", "stl", "glb"])
def test_formats_give_the_same_closed_surface(tmp_path, ending):
    v, f = t_pose()
    mesh = closed_surface(read_person(export(tmp_path / f"scan.{ending}", v, f)))
    assert len(mesh.vertices) == len(v)
    assert is_closed(mesh.faces)
    assert enclosed_volume(mesh.vertices, mesh.faces) == pytest.approx(enclosed_volume(v, f), rel=1e-5)
    assert mesh.notes == ()
    assert mesh.up == ("+y" if ending == "glb" else "")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v, f: (v / 1000, f), "in m the person would be 1.7 mm tall; no usual unit makes that a person"),
        (lambda v, f: (1000 * v, f), "would be 1.7e[+]03 m tall; its coordinates seem to be in mm"),
        (lambda v, f: (v, f[150:]), r"is not closed: \d+ edges have one face only"),
        (lambda v, f: (np.concatenate([v, v + [2, 0, 0]]), np.concatenate([f, f + len(v)])), r"2 parts \(50 %, 50 %"),
        (lambda v, f: (v, np.concatenate([f, [[f[0, 0], f[0, 1], 9]]])), "is not a manifold: 1 edges belong to three"),
        (lambda v, f: (np.where(np.arange(len(v))[:, None] == 5, np.nan, v), f), "1 vertices that are not finite"),
        (lambda v, f: (v * [1, 1, 0], f), "area 0|flat|does not look like"),
        (lambda v, f: (v * [0.3, 0.3, 1.0], f), "does not look like one person in any known pose"),
    ],
    ids=["millimetres", "kilometres", "open", "two people", "three faces", "nan", "flat", "pole"],
)
def test_meshes_that_cannot_be_rigged_say_why(tmp_path, change, message):
    v, f = change(*t_pose())
    with pytest.raises(InputError, match=message):
        rig_mesh(export(tmp_path / "scan.ply", v, f))


def test_specks_small_holes_and_inward_faces_are_mended():
    v, f = t_pose()
    speck = trimesh.creation.icosphere(1, 0.004)
    speck.apply_translation([0.5, 0.5, 0.5])
    vertices = np.concatenate([v, speck.vertices])
    faces = np.concatenate([np.delete(f, [10, 900], axis=0)[:, ::-1], speck.faces + len(v)]).astype(np.int32)
    mesh = closed_surface(PersonMesh(vertices, faces))
    assert is_closed(mesh.faces)
    assert enclosed_volume(mesh.vertices, mesh.faces) == pytest.approx(enclosed_volume(v, f), rel=1e-3)
    assert set(mesh.notes) == {
        "1 small loose parts were left out",
        "small holes were closed",
        "its faces looked inward and were turned",
    }


def test_faces_that_turn_either_way_are_turned():
    v, f = t_pose()
    mixed = f.copy()
    mixed[::3] = mixed[::3, ::-1]
    turned = closed_surface(PersonMesh(v, mixed))
    assert is_closed(turned.faces)
    assert enclosed_volume(turned.vertices, turned.faces) == pytest.approx(enclosed_volume(v, f), rel=1e-9)
    strip = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4], [4, 5, 1], [5, 0, 1]])  # Moebius's
    with pytest.raises(InputError, match="no inside and outside"):
        closed_surface(PersonMesh(np.random.default_rng(0).normal(size=(6, 3)), strip))


@pytest.mark.parametrize("names", ["own", "mixamo"])
def test_a_skinned_glb_keeps_its_joints_and_weights(tmp_path, small_motion, names):
    own = human()
    body = own if names == "own" else renamed_body(own, MIXAMO)
    write_glb(tmp_path / "avatar.glb", replace(small_motion, skeleton=body.skeleton), body)
    subject = rig_mesh(tmp_path / "avatar.glb")
    np.testing.assert_allclose(subject.body.skeleton.rest_joints, own.skeleton.rest_joints, atol=0.01)
    np.testing.assert_allclose(subject.body.joints(subject.pose), own.skeleton.rest_joints, atol=1e-4)
    # vertices may be in another order
    order = np.lexsort(subject.body.fine.dense_weights(19).T)
    there = np.lexsort(own.fine.dense_weights(19).T)
    np.testing.assert_allclose(
        np.sort(subject.body.fine.dense_weights(19)[order], axis=0),
        np.sort(own.fine.dense_weights(19)[there], axis=0),
        atol=0.02,
    )
    assert any("19 joints" in n for n in subject.notes)
    fresh = read_person(tmp_path / "avatar.glb")
    assert fresh.rig is not None
    assert len(fresh.rig.names) == 19


def smpl_like(path: Path, **changes: Any) -> Path:
    """A model in SMPL's format made of the template: 24 joints, Y up, T pose."""
    body = human()
    pose = known_pose(body, "t")
    v, joints = body.skin(pose, body.fine) @ Y_UP.T, body.joints(pose) @ Y_UP.T
    ours = {"spine1": "spine", "spine2": "chest", "left_collar": "left_clavicle", "right_collar": "right_clavicle"}
    names = [*SMPL_JOINTS, "left_hand", "right_hand"]
    parent = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21]
    place, weight = np.zeros((24, 3)), np.zeros((len(v), 24))
    dense = body.fine.dense_weights(19)
    for k, name in enumerate(names):
        mine = ours.get(name, name)
        if mine in JOINT_NAMES:
            place[k], weight[:, k] = joints[JOINT_NAMES.index(mine)], dense[:, JOINT_NAMES.index(mine)]
        else:
            place[k] = place[parent[k]] + 0.03 * (place[parent[k]] - place[parent[parent[k]]])
    regressor = place @ np.linalg.pinv(v)  # (24, V): exact for these vertices
    arrays: dict[str, Any] = {
        "v_template": v,
        "f": body.fine.faces.astype(np.uint32),
        "weights": weight,
        "J_regressor": regressor,
        "kintree_table": np.array([[2**32 - 1, *parent[1:]], range(24)], dtype=np.uint32),
    } | changes
    np.savez(path, **arrays)
    return path


def test_a_model_in_smpl_format_is_read_with_joints_and_weights(tmp_path):
    subject = rig_mesh(smpl_like(tmp_path / "model.npz"))
    own = human()
    rest, truth = subject.body.skeleton.rest_joints, own.skeleton.rest_joints
    assert np.linalg.norm(rest - truth, axis=1).mean() < 0.02
    assert any("+y up" in n for n in subject.notes)
    assert subject.body.stature == pytest.approx(1.70, abs=0.02)
    posed = subject.body.skin(subject.pose, subject.body.fine)
    assert np.ptp(posed, axis=0) == pytest.approx(np.ptp(own.skin(known_pose(own, "t"), own.fine), axis=0), abs=1e-3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"J_regressor": np.array([{"sparse": 1}], dtype=object)}, "J_regressor holds object, which is not allowed"),
        ({"weights": np.zeros((10, 24))}, "do not belong to one model"),
        ({"f": np.zeros(3)}, "vertices and 1 faces|do not belong"),
    ],
)
def test_models_that_would_run_code_or_do_not_fit_are_refused(tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        read_person(smpl_like(tmp_path / "model.npz", **changes))


def npz(name, data):
    """An archive with one entry."""
    with zipfile.ZipFile(stream := io.BytesIO(), "w") as archive:
        archive.writestr(name, data)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.ply", b"", "is empty"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 99999999999\n", "cannot be read as PLY|0 vertices"),
        ("a.stl", b"solid x\nfacet", "cannot be read as STL|0 vertices"),
        ("a.obj", b"mtllib ../../etc/passwd\nv 0 0 0\n", "cannot be read as OBJ|vertices and 0 faces"),
        ("a.glb", b"glTF\x02\x00\x00\x00\xff\xff\xff\x7f", "read as a skinned GLB, holds something"),
        ("a.gltf", b"{}", "names other files"),
        ("a.fbx", b"x", "export the scan in one of these formats"),
        ("a.npz", b"x", "is not a model in SMPL's format, or is damaged: .*; save v_template"),
        ("a.npz", npz("a.npy", b""), "'v_template' is missing"),
        ("a.npz", npz("v_template.npy", b"nothing"), "is not a model in SMPL's format"),
        ("a.pkl", b"cos\nsystem\n", "is a pickle, which may run any program"),
    ],
)
def test_damaged_and_foreign_files_are_named(tmp_path, name, data, message):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        read_person(path)
    assert name in str(caught.value)
