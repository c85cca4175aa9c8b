"""OpenSim model (.osim) of the tracked body: joints, lengths, masses, and landmarks as markers; files for OpenSim's IK.

Nothing is scaled from a generic model. The coordinates are those of motion.mot: the same names, axes and neutral pose
(`hypose.body.joint_angles`), so the motion plays on the model as it was tracked. Segment frames are OpenSim's: X
forwards, Y up, Z right in the anatomical neutral, with the origin at the joint towards the pelvis.

The clavicles only move the shoulder's centre (coordinates in metres), because OpenSim's full-body model measures the
upper arm relative to the chest, as hypose does. Forearm and hand have OpenSim's coordinates for pronation and wrist,
locked at zero, because they are not tracked. There are no muscles.

Source: Rajagopal et al. 2016 for the definitions of the joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from hypose.body.anthropometry import segment_masses
from hypose.body.body import Body
from hypose.body.joint_angles import (
    BODY_AXES,
    continuous_euler_zxy,
    hinge_axis,
    is_length,
    neutral_frames,
    straight_offset,
)
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.geometry import Array, so3_exp
from hypose.io.files import write_text
from hypose.io.motions.marker_files import write_trc

_X, _Y, _Z = np.eye(3)
_SIDES = (("r", "right", 1.0), ("l", "left", -1.0))
# Degree of the polynomial for a shoulder's sideways motion; accurate to 0.2 mm over the clavicle's range.
_ORDER = 5

# name of the segment: (joint of the skeleton at its origin, joints that carry its skin)
_TRUNK = {
    "pelvis": ("pelvis", ("pelvis",)),
    "torso": ("spine", ("spine", "chest", "left_clavicle", "right_clavicle")),
    "head": ("neck", ("neck", "head")),
}
_LIMBS = {"femur": "hip", "tibia": "knee", "calcn": "ankle", "humerus": "shoulder", "ulna": "elbow", "hand": "wrist"}


def shoulder_places(skeleton: Skeleton, poses: Array) -> tuple[tuple[str, ...], Array]:
    """Compute the shoulder coordinates: the displacement of each shoulder's centre by the clavicle, from its place at
    rest.

    skeleton: skeleton of the tracked body.
    poses: (T, D) pose vectors.
    Returns: 4 coordinate names; (T, 4) m, forwards and up relative to the chest, right and left.
    """
    columns = {}
    for s, side, _ in _SIDES:
        y, z = skeleton.dofs_of(f"{side}_clavicle")
        columns[f"shoulder_{s}_tx"], columns[f"shoulder_{s}_ty"], _ = _moved(skeleton, side, poses[:, y], poses[:, z]).T
    return tuple(columns), np.stack(list(columns.values()), axis=1)


def _moved(skeleton: Skeleton, side: str, about_y: Array, about_z: Array) -> Array:
    """Compute how rotations of a clavicle move the shoulder's centre.

    side: "left" or "right".
    about_y, about_z: (N,) angles about the clavicle's two axes, rad.
    Returns: (N, 3) displacement in the chest's frame, X forwards, Y up, Z right, m.
    """
    y, z = skeleton.dofs_of(f"{side}_clavicle")
    offset = skeleton.rest_offsets[skeleton.joint(f"{side}_shoulder")]
    turned = so3_exp(about_y[:, None] * skeleton.axes[y]) @ so3_exp(about_z[:, None] * skeleton.axes[z])
    return (turned @ offset - offset) @ BODY_AXES.T


def write_osim(path: str | Path, body: Body) -> None:
    """Write the OpenSim model of a body (metres, kg); its mass is computed from its volume.

    Raises: InputError where the body lacks one of the human joints.
    """
    _write_xml(path, _Writer(body).document(Path(path).stem))


def _write_xml(path: str | Path, root: Xml.Element) -> None:
    """Write an XML document, indented as OpenSim does."""
    Xml.indent(root, "\t")
    write_text(path, '<?xml version="1.0" encoding="UTF-8" ?>\n' + Xml.tostring(root, encoding="unicode") + "\n")


def marker_names(body: Body) -> tuple[str, ...]:
    """List the markers of the model: joint centres, then the body's landmarks."""
    return (*body.skeleton.joint_names, *body.landmarks.names)


class _Writer:
    """Writer of the parts of a model; segments are named as in OpenSim's full-body model.

    body: the body at rest, model frame, m.

    Attributes:
    origin: joint of the skeleton at the origin of each segment.
    segment_of: segment that carries the skin of each joint.
    neutral: rotation (3, 3) of each joint's frame in the anatomical neutral.
    masses: mass (kg), centre and inertia of each segment.
    """

    def __init__(self, body: Body) -> None:
        self.body, self.skeleton = body, body.skeleton
        self.origin = {name: joint for name, (joint, _) in _TRUNK.items()}
        carried = {name: joints for name, (_, joints) in _TRUNK.items()}
        for s, side, _ in _SIDES:
            for name, joint in _LIMBS.items():
                self.origin[f"{name}_{s}"] = f"{side}_{joint}"
                carried[f"{name}_{s}"] = (f"{side}_{joint}",)
        self.segment_of = {joint: name for name, joints in carried.items() for joint in joints}
        self.neutral = neutral_frames(self.skeleton)
        self.masses = segment_masses(body, carried)

    def local(self, segment: str, points: Array) -> Array:
        """Convert points (N, 3) of the model frame at rest to the frame of a segment."""
        joint = self.origin[segment]
        d = points - self.skeleton.rest_joints[self.skeleton.joint(joint)]
        return d @ (BODY_AXES @ self.neutral[joint]).T

    def document(self, name: str) -> Xml.Element:
        """Make the whole document; `name` is that of the model."""
        root = Xml.Element("OpenSimDocument", Version="40000")
        about = {
            "credits": "hypose: a model of the tracked body, made of its own joints, lengths and volume",
            "length_units": "meters",
            "force_units": "N",
            "gravity": "0 -9.80665 0",
        }
        model = put(root, "Model", children=about, name=name)
        bodies = put(put(model, "BodySet", name="bodyset"), "objects")
        for segment, m in self.masses.items():
            turn = BODY_AXES @ self.neutral[self.origin[segment]]
            inertia = turn @ m.inertia @ turn.T
            six = [*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
            values = {"mass": [m.mass], "mass_center": self.local(segment, m.centre[None])[0], "inertia": six}
            put(bodies, "Body", children={tag: _numbers(v) for tag, v in values.items()}, name=segment)
        self.joints(put(put(model, "JointSet", name="jointset"), "objects"))
        self.markers(put(put(model, "MarkerSet", name="markerset"), "objects"))
        return root

    def joints(self, joints: Xml.Element) -> None:
        """Add all joints: of the trunk, and of the legs and arms of both sides."""
        moves = [(f"pelvis_t{a}", e) for a, e in zip("xyz", (_X, _Y, _Z), strict=True)]
        turn = [("pelvis_tilt", _Z), ("pelvis_list", _X), ("pelvis_rotation", _Y)]
        self.joint(joints, "ground_pelvis", "", "pelvis", turn, moves)
        self.joint(joints, "lumbar", "pelvis", "torso", _ball("lumbar_extension lumbar_bending lumbar_rotation"))
        self.joint(joints, "neck", "torso", "head", _ball("neck_flexion neck_bending neck_rotation"))
        for s, side, sign in _SIDES:
            femur, tibia, calcn, humerus, ulna, hand = (f"{name}_{s}" for name in _LIMBS)
            turn = _ball(f"hip_flexion_{s} hip_adduction_{s} hip_rotation_{s}", sign)
            self.joint(joints, f"hip_{s}", "pelvis", femur, turn)
            self.hinge(joints, f"knee_{s}", f"knee_angle_{s}", femur, tibia)
            # the ankle's third angle is not free: it keeps its value at rest
            rest = BODY_AXES @ self.neutral[f"{side}_knee"] @ BODY_AXES.T
            fixed = float(continuous_euler_zxy(rest[None, None])[0, 0, 2])
            ankle = [(f"ankle_angle_{s}", _Z), (f"subtalar_angle_{s}", sign * _X), (fixed, _Y)]
            self.joint(joints, f"ankle_{s}", tibia, calcn, ankle)
            self.shoulder(joints, s, side, _ball(f"arm_flex_{s} arm_add_{s} arm_rot_{s}", sign))
            self.hinge(joints, f"elbow_{s}", f"elbow_flex_{s}", humerus, ulna)
            wrist = [(f"pro_sup_{s}", sign * _Y), (f"wrist_flex_{s}", _Z), (f"wrist_dev_{s}", sign * _X)]
            self.joint(joints, f"wrist_{s}", ulna, hand, wrist, locked=True)

    def joint(
        self,
        joints: Xml.Element,
        name: str,
        parent: str,
        child: str,
        turn: Sequence[tuple[str | float, Array]],
        moves: Sequence[tuple] = (),
        limits: Mapping[str, tuple[float, float]] | None = None,
        locked: bool = False,
    ) -> None:
        """Add a CustomJoint: successive rotations about axes in the parent's frame, and translations along axes.

        joints: XML element of the joints.
        parent, child: segment above it, "" for the ground, and segment below it, which turns at its place at rest.
        turn: for each rotation the name of its coordinate, or a fixed angle (rad), and its axis (3,).
        moves: for each translation the same, and its law as in `_axis`, from the origin of the segment above; none
            where the joint does not translate.
        limits: lower and upper limit of coordinates by name, rad or m; the others are free.
        locked: the coordinates are fixed.
        """
        sockets = {f"socket_{end}_frame": f"{name}_{end}" for end in ("parent", "child")}
        joint, limits = put(joints, "CustomJoint", children=sockets, name=name), limits or {}
        names = dict.fromkeys(n for n, *_ in (*turn, *moves) if isinstance(n, str))
        names |= dict.fromkeys(n for group, *_ in moves if isinstance(group, tuple) for n in group)
        coordinates = put(joint, "coordinates")
        for coordinate in names:
            reach = limits.get(coordinate, (-10.0, 10.0) if is_length(coordinate) else (-2 * np.pi, 2 * np.pi))
            about = {
                "default_value": "0",
                "range": _numbers(reach),
                "clamped": "true" if coordinate in limits else "false",
                "locked": "true" if locked else "false",
            }
            put(coordinates, "Coordinate", children=about, name=coordinate)
        place = np.zeros(3) if moves else self.place(parent, child)
        above = f"/bodyset/{parent}" if parent else "/ground"
        frames = put(joint, "frames")
        for suffix, frame, where in (("parent", above, place), ("child", f"/bodyset/{child}", np.zeros(3))):
            about = {"socket_parent": frame, "translation": _numbers(where), "orientation": "0 0 0"}
            put(frames, "PhysicalOffsetFrame", children=about, name=f"{name}_{suffix}")
        turns: list[tuple] = [*turn]
        if len(turns) == 1:  # completed to three independent axes
            axis = turn[0][1]
            across = np.asarray(np.cross(axis, np.eye(3)[np.abs(axis).argmin()]), dtype=np.float64)
            turns += [(0.0, across), (0.0, np.asarray(np.cross(axis, across), dtype=np.float64))]
        shifts = moves or [(0.0, axis) for axis in (_X, _Y, _Z)]
        transform = put(joint, "SpatialTransform")
        for kind, parts in (("rotation", turns), ("translation", shifts)):
            for k, part in enumerate(parts, 1):
                _axis(transform, f"{kind}{k}", *part)

    def hinge(self, joints: Xml.Element, name: str, angle: str, parent: str, child: str) -> None:
        """Add a hinge, whose `angle` is limited, in rad from the straight limb."""
        joint, s = self.origin[child], self.skeleton
        axis = BODY_AXES @ self.neutral[self.origin[parent]] @ hinge_axis(s, joint)
        d, offset = s.dofs_of(joint)[0], straight_offset(s, joint)
        limits = {angle: (float(s.lower[d] + offset), float(s.upper[d] + offset))}
        self.joint(joints, name, parent, child, [(angle, axis)], limits=limits)

    def place(self, parent: str, child: str) -> Array:
        """Compute the origin (3,) of the segment `child` at rest, in the frame of the segment `parent`, m."""
        return self.local(parent, self.skeleton.rest_joints[self.skeleton.joint(self.origin[child])][None])[0]

    def shoulder(self, joints: Xml.Element, s: str, side: str, turn: Sequence) -> None:
        """Add a shoulder: turns, and the motion of its centre by the clavicle.

        s, side: short and long name of the side.
        turn: as of `joint`.
        The centre moves freely forwards and up; its sideways motion, which follows from the clavicle's constant length,
        is a polynomial of these two.
        """
        skeleton = self.skeleton
        ranges = [np.linspace(skeleton.lower[d], skeleton.upper[d], 13) for d in skeleton.dofs_of(f"{side}_clavicle")]
        y, z = (g.ravel() for g in np.meshgrid(*ranges))
        a, b, c = _moved(skeleton, side, y, z).T
        powers = [(i, j) for i in range(_ORDER + 1) for j in range(_ORDER + 1 - i)]
        design = np.stack([a**i * b**j for i, j in powers], axis=1)
        law = np.asarray(np.linalg.lstsq(design, c, rcond=None)[0], dtype=np.float64)
        place, free = self.place("torso", f"humerus_{s}"), (f"shoulder_{s}_tx", f"shoulder_{s}_ty")
        law[0] += place[2]
        moves = [(free[0], _X, place[0]), (free[1], _Y, place[1]), (free, _Z, law)]
        limits = {name: (float(x.min()), float(x.max())) for name, x in zip(free, (a, b), strict=True)}
        self.joint(joints, f"shoulder_{s}", "torso", f"humerus_{s}", turn, moves, limits)

    def markers(self, parent: Xml.Element) -> None:
        s, marks = self.skeleton, self.body.landmarks
        carriers = [*range(len(s.joint_names)), *marks.joint.tolist()]
        points = np.concatenate([s.rest_joints, s.rest_joints[marks.joint] + marks.offset])
        for name, carrier, point in zip(marker_names(self.body), carriers, points, strict=True):
            segment = self.segment_of[s.joint_names[carrier]]
            place = _numbers(self.local(segment, point[None])[0])
            about = {"socket_parent_frame": f"/bodyset/{segment}", "location": place, "fixed": "false"}
            put(parent, "Marker", children=about, name=name)


def _ball(names: str, sign: float = 1.0) -> list[tuple[str, Array]]:
    """List the three named angles of a ball joint with their axes; sign: -1 for the left side."""
    return list(zip(names.split(), (_Z, sign * _X, sign * _Y), strict=True))


def _axis(
    parent: Xml.Element, name: str, free: str | float | tuple[str, ...], axis: Array, law: float | Array = 0.0
) -> None:
    """Add one axis of a transform.

    parent: XML element of the transform.
    name: rotation1 to rotation3, or translation1 to translation3.
    axis: (3,) direction.
    free: name of its coordinate, a fixed value, or the names of two coordinates.
    law: offset added to one coordinate, or coefficients of the polynomial of two.
    """
    coordinates = (free,) if isinstance(free, str) else free if isinstance(free, tuple) else ()
    about = {"coordinates": " ".join(coordinates), "axis": _numbers(axis)}
    if isinstance(free, tuple):
        kind, function = "MultivariatePolynomialFunction", {"coefficients": _numbers(np.asarray(law))}
        function |= {"dimension": str(len(free)), "order": str(_ORDER)}
    elif isinstance(free, str):
        kind, function = "LinearFunction", {"coefficients": _numbers([1, float(law)])}
    else:
        kind, function = "Constant", {"value": _numbers([free])}
    put(put(parent, "TransformAxis", children=about, name=name), kind, children=function, name="function")


def put(
    parent: Xml.Element, tag: str, text: str = "", children: Mapping[str, str] | None = None, **attributes: str
) -> Xml.Element:
    """Append a new XML element to `parent` and return it.

    tag: its name.
    text: its content.
    attributes: its attributes by name.
    children: texts of its child elements by their tags.
    """
    entry = Xml.SubElement(parent, tag, attributes)
    entry.text = text or None
    for name, content in (children or {}).items():
        put(entry, name, content)
    return entry


def _numbers(values: Sequence[float] | Array) -> str:
    """Format numbers as in files of OpenSim."""
    return " ".join(f"{float(v):.9g}" for v in values)


# ---- opensim ik ----------------------------------------------------------------------------------------------------
# Further files for OpenSim's inverse kinematics: markers of the tracked body and a set-up with weights.
#
# The markers are those of the model (`opensim_model.marker_names`): joint centres and the body's landmarks, in the
# frames of the motion. A marker's weight is the inverse of its joint's variance over the clip, and in single frames
# it is missing where its joint is more likely wrong than right; OpenSim's tool knows no weights that change by the
# frame.


_USUAL_SD = 0.02  # m: the weight of a marker with it is 1
_WEIGHTS = (0.05, 20.0)


def write_ik_markers(path: str | Path, motion: Motion, body: Body) -> None:
    """Write the markers of the model in every frame as a TRC file (m); the motion must have poses.

    In single frames the markers of a joint that is more likely wrong than right are left out.
    """
    assert motion.poses is not None
    points = np.concatenate([motion.joints, body.landmark_points(motion.poses)], axis=1)
    if motion.error_probability is not None:
        wrong = np.nan_to_num(motion.error_probability) > 0.5
        wrong[motion.lost.astype(bool)] = False  # nothing is known of the frame: OpenSim uses the prediction
        points[wrong[:, _carriers(motion, body)]] = np.nan
    write_trc(path, marker_names(body), points, motion.frame_rate, start_time=float(motion.times[0]))


def write_ik_setup(path: str | Path, motion: Motion, body: Body, model: str, markers: str) -> None:
    """Write the set-up file of OpenSim's Inverse Kinematics tool.

    model, markers: names of the model and marker files, relative to the set-up file.
    """
    root = Xml.Element("OpenSimDocument", Version="40000")
    about = {
        "model_file": model,
        "constraint_weight": "Inf",
        "accuracy": "1e-05",
        "marker_file": markers,
        "time_range": _numbers([motion.times[0], motion.times[-1]]),
        "report_errors": "true",
        "output_motion_file": "motion_ik.mot",
    }
    tool = put(root, "InverseKinematicsTool", children=about, name="motion_ik")
    tasks = put(put(tool, "IKTaskSet"), "objects")
    for name, weight in zip(marker_names(body), marker_weights(motion, body).tolist(), strict=True):
        put(tasks, "IKMarkerTask", children={"apply": "true", "weight": f"{weight:.4g}"}, name=name)
    _write_xml(path, root)


def marker_weights(motion: Motion, body: Body) -> Array:
    """Compute the weight (M,) of each marker of the model from its joint's standard deviation; 2 cm has weight 1."""
    sd = np.where(motion.joint_sd > 0, motion.joint_sd, np.nan)
    usual = np.array([np.nanmedian(s) if np.isfinite(s).any() else _USUAL_SD for s in sd.T])
    return np.clip((_USUAL_SD / usual) ** 2, *_WEIGHTS)[_carriers(motion, body)]


def _carriers(motion: Motion, body: Body) -> list[int]:
    """List the index of the joint that carries each marker."""
    return [*range(len(motion.skeleton.joint_names)), *body.landmarks.joint.tolist()]
