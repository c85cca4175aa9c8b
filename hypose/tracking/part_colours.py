"""What colours a person's parts have: learnt view by view while the pose is certain, and asked when masks cannot tell.

An arm before the trunk or behind it, folded or hanging where another one hangs, leaves the same outline. Its hand and
its sleeve seldom leave the same picture. So the pixels of each part that is in front are counted by colour in frames in
which nothing is in doubt; of rival poses that is better whose parts lie where their colours are. What has the same
colours as its background says nothing, neither for nor against.

Arms where pictures show them: looked for about where they are held to be, before the trunk too.

What lies before the trunk has no outline. Its colours and the rims of its sleeves are in the pictures, and tell an arm
from one ten centimetres off, over which the masks are of two minds. So arms are drawn about their place, narrower and
narrower, and what the masks and the pictures like best holds the arm while the body is solved again.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.compute import reach
from hypose.compute.arrays import PreparedMasks
from hypose.compute.part_colours import colour_sums, rim_edges, shown_parts
from hypose.evidence.colours import COLOURS, SHADES
from hypose.evidence.frame import Colours
from hypose.evidence.terms import PointTerm
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.layer import Memory
from hypose.tracking.arm_workspace import ArmReach
from hypose.tracking.costs import frame_energy
from hypose.tracking.frame_evidence import PreparedFrame


def pictured_arms(
    arms: Iterable[ArmReach], pose: Array, frame: PreparedFrame, settings: ColourSettings, rng: np.random.Generator
) -> tuple[Array, PointTerm] | None:
    """The pose (D,) with its arms where the masks and the pictures like them best near by, and points that hold them
    there in a solve; None when nothing is known of pictures, or nothing near by is better."""
    if known_colours(frame, settings) is None:
        return None
    found = pose
    for arm in arms:
        found = _one_arm(arm, found, frame, settings, rng)
    if found is pose:
        return None
    body, chains = frame.body, [arm.chain for arm in arms]
    joint = np.array([j for _, elbow, wrist in chains for j in (elbow, wrist, wrist)])
    offset = np.concatenate([[np.zeros(3), np.zeros(3), 0.6 * arm.tip] for arm in arms])
    rotations, centres = body.skeleton.forward(found)
    at = centres[joint] + np.einsum("kij,kj->ki", rotations[joint], offset)
    return found, PointTerm(at, np.full(len(joint), settings.strength), joint, offset, settings.hold)


def _one_arm(
    arm: ArmReach, pose: Array, frame: PreparedFrame, settings: ColourSettings, rng: np.random.Generator
) -> Array:
    """The pose (D,) with this arm where it is liked best; the pose itself when that is where it is."""
    body, o, masks = frame.body, settings, frame.silhouettes.masks
    rest = reach.standing(pose, body.skeleton.tree, body.coarse.arrays, masks, arm.moving)
    views = max(int(masks.usable.sum()), 1)
    best, least, most = pose, np.inf, np.inf
    for step in o.steps:
        poses = np.repeat(best[None], 1 + o.draws, 0)
        poses[1:, arm.own] += step * rng.standard_normal((o.draws, len(arm.own)))
        poses = body.skeleton.clamp(poses)
        poses[0] = best
        energy = frame_energy(poses, frame, arm.moving, rest)
        most = min(most, o.ratio * energy[0])
        good = np.flatnonzero(energy <= most)
        score = energy[good] / views + o.weight * colour_scores(poses[good], frame, o)
        n = int(score.argmin())
        if good[n] and score[n] < least:
            best = poses[good[n]]
        least = min(least, float(score[n]))
    return best


COUNTS = "colours"
"""Name of the counts (C, P, COLOURS) in the tracker's memory."""
PARTS = (
    ("neck", "head"),
    ("pelvis", "spine", "chest", "left_clavicle", "right_clavicle"),
    ("left_shoulder", "right_shoulder"),
    ("left_elbow", "right_elbow"),
    ("left_wrist", "right_wrist"),
    ("left_hip", "right_hip"),
    ("left_knee", "right_knee"),
    ("left_ankle", "right_ankle"),
)
"""Joints whose skin is one part; both sides wear the same."""
_ARMS = tuple(tuple(f"{side}_{n}" for n in ("shoulder", "elbow", "wrist")) for side in ("left", "right"))
_CROSS = np.ones((3, 3), np.uint8)
_KERNEL = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32) / 16
"""Neighbouring colours are nearly the same: noise, light, and the colours of the cloth's threads."""


@dataclass(frozen=True)
class ColourSettings:
    """Learnt colours and their weight.

    surely: weight among its rivals that a pose must have to be learnt from; elsewhere: m, a rival's arm that is farther
    off is not learnt from; memory: share of what was counted before that counts in the next frame; few: pixels that a
    part must have shown to be half known; most: log-likelihood ratio of one pixel, at most. weight: of the pictures'
    score relative to the mismatch of rivals; edges: of the rims of arms in it, relative to the colours. tried: rivals
    whose arms are looked for nearby, with so many draws at each of the steps (rad, sd); ratio: of their energy to that
    of where they are held to be, at most; hold, strength: m (one sd) and weight of the points that hold them in a
    solve.

    Chosen on folded arms of the seeds 503 and 505."""

    surely: float = 0.8
    elsewhere: float = 0.08
    memory: float = 0.99
    few: float = 100.0
    most: float = 3.0
    weight: float = 0.3
    edges: float = 0.3
    tried: int = 1
    draws: int = 64
    steps: tuple[float, ...] = (0.3, 0.15, 0.07)
    ratio: float = 1.04
    hold: float = 0.02
    strength: float = 4.0


@dataclass(frozen=True)
class KnownColours:
    """Prior knowledge of a person's colours, and what a frame shows of them. codes (C, h, w); table (C, P, COLOURS):
    log-likelihood ratios of each colour, in a part against anywhere on the person; masks: usable where there is a
    picture; edges: of `rim_edges`."""

    codes: NDArray[np.uint16]
    table: NDArray[np.float32]
    masks: PreparedMasks
    edges: tuple[NDArray[np.float32], ...]


def known_colours(frame: PreparedFrame, settings: ColourSettings) -> KnownColours | None:
    """None where there are no pictures, or nothing has been learnt."""
    if "known colours" not in frame.shared:
        counts, masks, known = frame.memory.get(COUNTS), frame.silhouettes.masks, None
        for colours in frame.frame.of(Colours):
            seen = masks._replace(usable=masks.usable & colours.seen) if len(masks.usable) else masks
            if counts is not None and len(counts) == len(masks.masks) and seen.usable.any():
                table, edges = table_of(counts, settings), rim_edges(seen, colours.edges)
                known = KnownColours(colours.codes, table, seen, edges)
        frame.shared["known colours"] = known
    return frame.shared["known colours"]


def colour_scores(poses: Array, frame: PreparedFrame, settings: ColourSettings) -> Array:
    """(N,) how badly the colours of the pictures fit poses (N, D): the mean over the views of the negative
    log-likelihood ratio (the part that is shown against the whole person), summed over the pixels, per pixel of the
    mask; and how badly edges lie along the rims of arms that are before the rest, per square root of these pixels.
    Zeros where nothing is known."""
    known = known_colours(frame, settings)
    if known is None:
        return np.zeros(len(poses))
    faces, part, arm = part_layout(frame.body)
    limb = (1 + arm).astype(np.uint8)
    about = known.masks, known.codes, known.table, limb, known.edges
    sums, rims = colour_sums(frame.body.skin(poses), faces, part, *about)
    use = known.masks.usable
    area = np.maximum(known.masks.areas[use], 1)
    return -(sums[:, use] / area + settings.edges * rims[:, use] / np.sqrt(area)).mean(1)


def table_of(counts: NDArray[np.float32], settings: ColourSettings) -> NDArray[np.float32]:
    """(C, P, COLOURS) log-likelihood ratios of each colour: in a part, against anywhere on the person."""
    whole = counts.sum(1, keepdims=True)
    share = (whole + 1e-3) / (whole + 1e-3).sum(2, keepdims=True)
    of_part = (counts + settings.few * share) / (counts.sum(2, keepdims=True) + settings.few)
    return np.clip(np.log(of_part / share), -settings.most, settings.most).astype(np.float32)


@dataclass(frozen=True)
class LearnColours:
    """Learns what colours the parts have from frames in which the pose is certain."""

    settings: ColourSettings = ColourSettings()

    def __call__(self, memory: Memory, pose: Array, h: Hypotheses, frame: PreparedFrame, /) -> Memory:
        """The memory after a frame; see `Recipe.learn`."""
        if not frame.silhouettes.seen or h.weights.max() < self.settings.surely:
            return memory
        for colours in frame.frame.of(Colours):
            memory = self._learn(memory, colours, pose, h, frame)
        return memory

    def _learn(self, memory: Memory, colours: Colours, pose: Array, h: Hypotheses, frame: PreparedFrame) -> Memory:
        """Count the colours of one frame."""
        o, body, (faces, part, arm) = self.settings, frame.body, part_layout(frame.body)
        vertices = body.skin(pose)
        doubted = self._doubted(pose, h, body)
        for side in np.flatnonzero(doubted):
            part[arm == side] = len(PARTS)  # in front of others, but nothing to learn from
        masks = frame.silhouettes.masks
        use = masks.usable & colours.seen
        found = np.zeros((len(use), len(PARTS), COLOURS), np.float32)
        for c in np.flatnonzero(use).tolist():
            w, height = masks.sizes[c].tolist()
            shown, box = shown_parts(vertices, faces, part, masks.projections[c], (height, w))
            found[c] = counted_colours(shown[box], masks.masks[c][box], colours.codes[c][box])
        before = memory.get(COUNTS)
        if before is None or before.shape != found.shape:
            return {**memory, COUNTS: found}
        return {**memory, COUNTS: np.where(use[:, None, None], o.memory * before + found, before).astype(np.float32)}

    def _doubted(self, pose: Array, h: Hypotheses, body: Body) -> NDArray[np.bool_]:
        """(2,) whether some rival has the left or the right arm elsewhere."""
        rivals = h.values[h.weights > 0.02]
        at = body.joints(np.concatenate([pose[None], rivals]))
        s = body.skeleton
        ends = [[s.joint(n) for n in names[1:]] for names in _ARMS]
        apart = [np.linalg.norm(at[1:, own] - at[0, own], axis=-1).max(initial=0.0) for own in ends]
        return np.array(apart) > self.settings.elsewhere


def counted_colours(
    shown: NDArray[np.uint8], mask: NDArray[np.uint8], codes: NDArray[np.uint16]
) -> NDArray[np.float32]:
    """(P, COLOURS): how often each part has each colour, away from its rim."""
    if not shown.size:
        return np.zeros((len(PARTS), COLOURS), np.float32)
    inner = np.where(cv2.erode(shown, _CROSS) == cv2.dilate(shown, _CROSS), shown, 0)
    seen = (inner > 0) & (inner <= len(PARTS)) & (mask > 0)
    number = (inner[seen].astype(np.int64) - 1) * COLOURS + codes[seen]
    found = np.bincount(number, minlength=len(PARTS) * COLOURS).astype(np.float32)
    levels = found.reshape(len(PARTS) * SHADES[0], *SHADES[1:])
    spread = [cv2.filter2D(level, -1, _KERNEL, borderType=cv2.BORDER_CONSTANT) for level in levels]
    return np.stack(spread).reshape(len(PARTS), COLOURS).astype(np.float32)


def part_layout(body: Body) -> tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.int64]]:
    """Faces of the coarse mesh, the part of each (F,), and its arm: 0 left, 1 right, -1 none."""
    names = body.skeleton.joint_names
    number = np.array([next((k for k, own in enumerate(PARTS) if n in own), 1) for n in names])
    side = np.array([next((k for k, own in enumerate(_ARMS) if n in own), -1) for n in names])
    of_face = body.coarse.face_joint
    return body.coarse.faces, number[of_face].astype(np.uint8), side[of_face]
