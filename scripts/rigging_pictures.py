"""Draw the picture of docs/own-body.md: a rigged scan in poses it was not scanned in.

python scripts/rigging_pictures.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from benchmarks.synthetic.scans import scan_of
from hypose.body.body import Body
from hypose.body.default_body import JOINT_NAMES
from hypose.io.motions.meshes import PersonMesh
from hypose.pipeline.mesh_subject import MeshSubject, rig_mesh
from hypose.synthetic.subjects import load_subjects

mpl.use("Agg")
OUT = Path(__file__).resolve().parent.parent / "docs/images"
GREY = np.array([0.82, 0.80, 0.78])


def main() -> None:
    """Write the picture."""
    subject = load_subjects()["heavy"]
    vertices, _ = scan_of(subject, "standing", 0.001, np.random.default_rng(0))
    scan = PersonMesh(vertices, subject.faces)
    rigged = rig_mesh(scan)
    OUT.mkdir(exist_ok=True)
    poses_picture(scan, rigged)


def poses_picture(scan: PersonMesh, rigged: MeshSubject) -> None:
    """The scan, the template's joints in it, the body at rest (fine and coarse) and in three poses."""
    body, mesh = rigged.body, rigged.body.fine
    fig, ax = plt.subplots(figsize=(15, 4.2))
    parts = np.asarray(plt.get_cmap("tab20")(np.linspace(0, 1, 20)))[
        [0, 5, 10, 15, 3, 8, 13, 1, 6, 11, 16, 4, 9, 14, 2, 7, 12, 17, 18], :3
    ]
    blended = (mesh.dense_weights(len(JOINT_NAMES)) @ parts)[mesh.faces].mean(1)
    draw(ax, np.asarray(scan.vertices), scan.faces, GREY, 0.0)
    draw(ax, body.skin(rigged.pose, mesh), mesh.faces, GREY * 1.1, 1.0)
    joints = turned(body.joints(rigged.pose) - origin(body.skin(rigged.pose, mesh)))
    for j, p in enumerate(body.skeleton.parents):
        if p >= 0:
            ax.plot(joints[[j, p], 0] + 1.0, joints[[j, p], 2], "-o", c="#c02020", ms=3, lw=1)
    draw(ax, mesh.vertices, mesh.faces, blended, 2.2)
    draw(ax, body.coarse.vertices, body.coarse.faces, GREY, 3.5, edge="#555555")
    for k, changes in enumerate(POSES):
        draw(ax, body.skin(posed(body, changes), mesh), mesh.faces, blended, 4.8 + 1.3 * k)
    titles = ("scan", "joints found", "weights", "coarse mesh", "in new poses")
    for x, text in zip((0, 1.0, 2.2, 3.5, 6.1), titles, strict=True):
        ax.text(x, -0.14, text, ha="center", fontsize=11)
    finish(fig, ax, "own-body-poses.png")


# joint: rotation vector or angle, rad, beyond the rest pose
POSES: tuple[dict[str, tuple[float, ...]], ...] = (
    {
        "left_shoulder": (0, -1.2, 0),
        "right_elbow": (1.3,),
        "left_hip": (-1.1, 0, 0),
        "left_knee": (1.3,),
        "neck": (0, 0, 0.5),
    },
    {"left_shoulder": (0, -0.7, 0), "right_shoulder": (0, 0.7, 0), "left_hip": (0, -0.5, 0), "right_hip": (0, 0.5, 0)},
    {
        "spine": (0.5, 0, 0.3),
        "left_hip": (-1.4, 0, 0),
        "right_hip": (-1.4, 0, 0),
        "left_knee": (1.6,),
        "right_knee": (1.6,),
        "right_shoulder": (-1.0, 0.6, 0),
    },
)


def posed(body: Body, changes: dict[str, tuple[float, ...]]) -> np.ndarray:
    """(D,) the rest pose with some joints turned."""
    q = np.zeros(body.skeleton.dof)
    for joint, values in changes.items():
        q[body.skeleton.dofs_of(joint)] = values
    return body.skeleton.clamp(q)


def turned(v: np.ndarray, yaw: float = 0.35) -> np.ndarray:
    """Points (..., 3) seen a little from the side."""
    c, s = np.cos(yaw), np.sin(yaw)
    return v @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def origin(v: np.ndarray) -> np.ndarray:
    """(3,) the point on the floor under the middle of a mesh."""
    return np.array([*(0.5 * (v[:, :2].min(0) + v[:, :2].max(0))), v[:, 2].min()])


def draw(
    ax: Axes, v: np.ndarray, f: np.ndarray, colour: np.ndarray, x: float, edge: str = "face", yaw: float = 0.35
) -> None:
    """A shaded mesh, seen from the front, standing at x; colour (3,) or (F, 3)."""
    t = turned(v - origin(v), yaw)[f]
    n = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
    seen = np.flatnonzero(n[:, 1] < 0)
    seen = seen[np.argsort(-t[seen].mean(1)[:, 1])]
    light = 0.45 + 0.55 * np.clip(n[seen] @ np.array([0.3, -0.85, 0.45]), 0, 1)
    shade = np.clip(np.broadcast_to(colour, (len(f), 3))[seen] * light[:, None], 0, 1)
    ax.add_collection(
        PolyCollection(list(t[seen][:, :, [0, 2]] + [x, 0]), facecolors=shade, edgecolors=edge, linewidths=0.2)
    )


def finish(fig: Figure, ax: Axes, name: str) -> None:
    """Save and say how large the file became."""
    ax.set_aspect("equal")
    ax.autoscale()
    ax.axis("off")
    fig.savefig(OUT / name, dpi=100, bbox_inches="tight", pil_kwargs={"optimize": True})
    plt.close(fig)
    print(f"{OUT / name}: {(OUT / name).stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
