"""The subject's OpenSim model: OpenSim itself puts its markers where the tracked body has them."""

import json
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import pytest

from hypose.body.anthropometry import segment_masses
from hypose.body.default_body import human
from hypose.body.joint_angles import GROUND_AXES, joint_angles
from hypose.io.motions.export import export_motion
from hypose.io.motions.marker_files import read_mot
from hypose.io.motions.opensim_model import marker_names, marker_weights, shoulder_places, write_osim


@pytest.fixture(scope="module")
def poses():
    skeleton, rng = human().skeleton, np.random.default_rng(3)
    return rng.uniform(np.maximum(skeleton.lower, -0.8), np.minimum(skeleton.upper, 0.8), (6, skeleton.dof))


def _coordinates(poses):
    skeleton = human().skeleton
    names, values = joint_angles(skeleton, poses)
    more, places = shoulder_places(skeleton, poses)
    renamed = ["neck_flexion" if n == "neck_extension" else n for n in names]
    return [*renamed, *more], np.concatenate([values, places], axis=1)


def in_opensim(folder, names=(), values=()):
    """The total mass and the markers' places at rows of coordinates, as OpenSim has them of m.osim in the folder."""
    (folder / "c.json").write_text(json.dumps({"names": list(names), "values": np.asarray(values).tolist()}))
    command = [sys.executable, str(Path(__file__).with_name("opensim_places.py")), "m.osim", "c.json"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def test_markers_stand_where_the_body_has_them(tmp_path, poses, opensim):
    write_osim(tmp_path / "m.osim", human())
    found = in_opensim(tmp_path, *_coordinates(poses))
    want = np.concatenate([human().joints(poses), human().landmark_points(poses)], axis=1) @ GROUND_AXES.T
    feet = np.array([any(p in n for p in ("toe", "heel", "ball")) for n in marker_names(human())])
    for places, points in zip(found["markers"], want, strict=True):
        got = np.array([places[n] for n in marker_names(human())])
        assert np.abs(got - points)[~feet].max() < 3e-4
        # a foot has two angles in motion.mot; about its own long axis it is a few degrees more at the limits
        assert np.linalg.norm(got - points, axis=1)[feet].max() < 0.015
    assert found["mass"] == pytest.approx(1000 * human().fine.volume, rel=0.02)


def test_every_column_of_the_motion_is_in_the_model(tmp_path, small_motion):
    export_motion(small_motion, human(), tmp_path, ("mot", "osim"))
    model = Xml.parse(tmp_path / "motion.osim")
    coordinates = {c.get("name") for c in model.iter("Coordinate")}
    header = (tmp_path / "motion.mot").read_text().split("endheader\n")[1].splitlines()[0].split("\t")
    assert set(header[1:]) <= coordinates
    assert {"pro_sup_r", "wrist_flex_l"} <= coordinates - set(header)
    assert read_mot(tmp_path / "motion.mot")[2].shape == (60, len(header) - 1)
    markers = [m.get("name") for m in model.iter("Marker")]
    assert markers == list(marker_names(human()))
    assert [t.get("name") for t in Xml.parse(tmp_path / "motion_ik.xml").iter("IKMarkerTask")] == markers


def test_segments_have_the_masses_of_people():
    arms = {f"{s}_{n}": (f"{s}_{j}",) for s in ("left", "right") for n, j in (("arm", "shoulder"), ("thigh", "hip"))}
    whole = {"all": tuple(human().skeleton.joint_names)}
    masses = segment_masses(human(), arms | whole)
    total = masses["all"]
    assert total.mass == pytest.approx(1000 * human().fine.volume, rel=0.02)
    assert abs(total.centre[0]) < 2e-3  # the body is symmetric
    assert masses["left_thigh"].mass == pytest.approx(masses["right_thigh"].mass, rel=0.02)
    # de Leva 1996: an upper arm is 2.6 to 2.7 % of the body, a thigh 14 to 15 %, cut at the hip instead of the groin
    assert 0.02 < masses["left_arm"].mass / total.mass < 0.04 and 0.10 < masses["left_thigh"].mass / total.mass < 0.16
    for m in masses.values():
        moments = np.linalg.eigvalsh(m.inertia)
        assert (moments > 0).all() and moments[2] < moments[0] + moments[1]  # what a solid can have


def test_sure_joints_weigh_more(small_motion):
    body = human()
    sd = np.full((60, 19), 0.02)
    sd[:, 3] = 0.01
    sure = small_motion.__class__(**{**vars(small_motion), "joint_covariance": sd[..., None, None] ** 2 * np.eye(3)})
    weights = marker_weights(sure, body)
    assert weights[3] == pytest.approx(4) and weights[0] == pytest.approx(1)
