"""Fused points as a Motion: a skeleton that only names joints, parents before children."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hypose.body.motion import Motion, isotropic
from hypose.body.skeleton import Skeleton
from hypose.fusion import joints as jt
from hypose.fusion.trust import DOUBTFUL_P
from hypose.geometry import Array


def point_skeleton(
    joint_names: Sequence[str], parents: Sequence[int], lengths: Mapping[str, float] | None = None
) -> Skeleton:
    """A skeleton that only names joints: rigid, six degrees of freedom, for motions without poses. Joints stand above
    each other at rest by their bones' lengths (m, by joint name)."""
    n = len(joint_names)
    offsets = np.zeros((n, 3))
    offsets[1:, 2] = [(lengths or {}).get(name, 0.2) for name in joint_names[1:]]
    dofs = tuple(f"{joint_names[0]}_{a}" for a in ("tx", "ty", "tz", "rx", "ry", "rz"))
    return Skeleton(
        tuple(joint_names),
        np.array(parents, dtype=np.int64),
        offsets,
        np.arange(n) == 0,
        np.tile(np.eye(3), (2, 1)),
        np.zeros(6, dtype=np.int64),
        dofs,
        np.full(6, -1e3),
        np.full(6, 1e3),
        np.full(6, 0.1),
    )


def points_motion(
    names: tuple[str, ...],
    joints: Array,
    sd: Array,
    times: Array,
    lost: NDArray[np.bool_],
    n_sensors: NDArray[np.int64],
    lengths: Array,
    provenance: Mapping[str, Any],
    systematic: Array | None = None,
    wrong: Array | None = None,
) -> Motion:
    """A Motion with parents before children: the torso first, as the root. sd (T, J) m, of which systematic (T, J)
    would remain with more frames or sensors; wrong (T, J): how likely a joint is wrong."""
    order, parents = _topological(names)
    bone = {tuple(sorted(b)): float(v) for b, v in zip(jt.SKELETON_BONES.tolist(), lengths, strict=True)}
    by_name = {
        n: bone.get(tuple(sorted((i, int(jt.PARENT[i])))), 0.2) for i, n in enumerate(jt.COMMON) if jt.PARENT[i] >= 0
    }
    skeleton = point_skeleton([names[i] for i in order], parents, by_name)
    motion = Motion(
        skeleton,
        times,
        joints[:, order],
        None,
        isotropic(sd[:, order]),
        lost,
        n_sensors == 0,
        n_sensors,
        np.full(len(times), np.nan),
        provenance,
    )
    if wrong is None or systematic is None:
        return motion
    lasting = isotropic(systematic[:, order])
    p = np.nan_to_num(np.where(lost[:, None], np.fmax(wrong, 0.5), wrong)[:, order]).astype(np.float32)
    doubtful = p > DOUBTFUL_P
    return replace(motion, p_wrong=p, doubtful_joints=doubtful, doubtful=doubtful.any(1), systematic_covariance=lasting)


def _topological(names: tuple[str, ...]) -> tuple[list[int], list[int]]:
    """Order of the joints with parents first, and each one's parent in that order."""
    parent = [int(p) for p in jt.PARENT]
    if len(names) > 15:
        sets = [k for k in jt.joint_sets() if len(k.joint_names) == len(names)]
        known = sets[0] if sets else None
        anchors = anchors_of(known) if known is not None else {}
        at = {jt.plain_name(n): i for i, n in enumerate(known.joint_names)} if known is not None else {}
        parent += [anchors.get(at.get(jt.plain_name(n), -1), jt.TORSO) for n in names[15:]]
    order = [jt.TORSO]
    for j in order:
        order += [i for i, p in enumerate(parent) if p == j]
    place = {j: i for i, j in enumerate(order)}
    return order, [place[parent[j]] if parent[j] >= 0 else -1 for j in order]


def anchors_of(known: jt.JointSet) -> dict[int, int]:
    """For every joint of the set the common joint (0-14) it hangs from: the nearest towards the root, else a
    neighbour."""
    place = {int(j): i for i, j in enumerate(known.common)}
    out: dict[int, int] = {}
    for j in range(len(known.joint_names)):
        a = j
        while a >= 0 and a not in place:
            a = int(known.parent[a])
        out[j] = place.get(a, jt.TORSO)
    return out


def common_positions(motion: Motion) -> Array:
    """(T, 15, 3) m: the fused common joints in the order of joints.COMMON (a motion's own order starts at the
    torso)."""
    return motion.joints[:, [motion.skeleton.joint(n) for n in jt.COMMON]]
