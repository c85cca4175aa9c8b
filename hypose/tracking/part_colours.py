"""What colours a person's parts have: learnt view by view while the pose is certain, and asked when masks cannot tell.

An arm before the trunk or behind it, folded or hanging where another one hangs, leaves the same outline. Its hand and
its sleeve seldom leave the same picture. So the pixels of each part that is in front are counted by colour in frames in
which nothing is in doubt; of rival poses that is better whose parts lie where their colours are. What has the same
colours as what is behind it says nothing, neither for nor against.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose import compute
from hypose.body.body import Body
from hypose.evidence.colours import COLOURS, SHADES
from hypose.fitting.articulated import KeypointTerm
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.layer import Memory
from hypose.tracking.frame_evidence import PreparedFrame

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
_HEAD, _FOREARM, _HAND = 0, 3, 4
_NEAR = 0.05
_ARMS = tuple(tuple(f"{side}_{n}" for n in ("shoulder", "elbow", "wrist")) for side in ("left", "right"))
_CROSS = np.ones((3, 3), np.uint8)
_KERNEL = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32) / 16
"""Neighbouring colours are nearly the same: noise, light, and the colours of the cloth's threads."""


@dataclass(frozen=True)
class ColourSettings:
    """What is learnt, and what it weighs.

    surely: weight among its rivals that a pose must have to be learnt from; elsewhere: m, a rival's arm that is farther
    off is not learnt from; memory: share of what was counted before that counts in the next frame; few: pixels that a
    part must have shown to be half known; most: log-likelihood ratio of one pixel, at most. weight: of the colours'
    score beside the mismatch of rivals.
    reach: m in which a hand is looked for; least: pixels of it that must be in front; stay: log-likelihood ratio per
    pixel of the hand that it costs to lie as far as that off; told: that its pixels must have in the mean to say where
    it is; enough: pixels of a person in which it is looked for, larger
    pictures are made smaller; sd, pull: m and weight of its key points in a solve.

    Chosen on folded arms of the seeds 500 to 506."""

    surely: float = 0.8
    elsewhere: float = 0.08
    memory: float = 0.99
    few: float = 100.0
    most: float = 3.0
    weight: float = 0.15
    reach: float = 0.2
    least: int = 8
    stay: float = 1.0
    told: float = 1.0
    enough: int = 3000
    sd: float = 0.03
    pull: float = 1.0


@dataclass(frozen=True)
class KnownColours:
    """What is known of a person's colours, and what a frame shows of them. codes (C, h, w); table (C, P, COLOURS):
    log-likelihood ratios of each colour, in a part against anywhere on the person; masks: usable where there is a
    picture."""

    codes: NDArray[np.uint16]
    table: NDArray[np.float32]
    masks: compute.PreparedMasks


def known_colours(frame: PreparedFrame, settings: ColourSettings) -> KnownColours | None:
    """None where there are no pictures, or nothing has been learnt."""
    if "known colours" not in frame.shared:
        counts, colours, masks, known = frame.memory.get(COUNTS), frame.frame.colours, frame.masks, None
        if counts is not None and colours is not None and masks is not None and len(counts) == len(masks.masks):
            seen = masks._replace(usable=masks.usable & colours.seen)
            known = KnownColours(colours.codes, table_of(counts, settings), seen) if seen.usable.any() else None
        frame.shared["known colours"] = known
    return frame.shared["known colours"]


def colour_scores(poses: Array, frame: PreparedFrame, settings: ColourSettings) -> Array:
    """(N,) how badly the colours of the pictures fit poses (N, D): the mean over the views of the negative
    log-likelihood ratio (the part that is shown against the whole person), summed over the pixels, per pixel of the
    mask. Zeros where nothing is known."""
    known = known_colours(frame, settings)
    if known is None:
        return np.zeros(len(poses))
    faces, part, _ = layout(frame.body)
    sums = compute.colour_sums(frame.body.skin(poses), faces, part, known.masks, known.codes, known.table)
    use = known.masks.usable
    return -(sums[:, use] / np.maximum(known.masks.areas[use], 1)).mean(1)


def hands_by_colours(pose: Array, frame: PreparedFrame, settings: ColourSettings) -> KeypointTerm | None:
    """Where the colours around the hands of a pose (D,) say that these are, None where they say nothing.

    In each view the pixels in which a hand and its forearm are in front are moved about, to where the colours are most
    those of a hand and a forearm; wrist and hand are moved with them."""
    known = known_colours(frame, settings)
    if known is None:
        return None
    body, o, masks = frame.body, settings, known.masks
    faces, part, arm = layout(body)
    s = body.skeleton
    rotations, centres = s.forward(pose)
    vertices = body.skin(pose)
    wrists = [s.joint(names[2]) for names in _ARMS]
    tips = [body.landmarks.offset[body.landmarks.index(f"{side}_hand_tip")] for side in ("left", "right")]
    joint = np.repeat(wrists, 2)
    offset = np.stack([f * tip for tip in tips for f in (0.0, 0.6)])
    at = centres[joint] + np.einsum("kij,kj->ki", rotations[joint], offset)
    own = (part + 16 * (arm == 1)).astype(np.uint8)
    points, sizes = np.zeros((len(masks.usable), len(joint), 3)), list[float]()
    for c in np.flatnonzero(masks.usable).tolist():
        step = max(1, round(float(np.sqrt(masks.areas[c] / o.enough))))
        p, (w, h) = masks.projections[c], masks.sizes[c].tolist()
        x = at @ p[:, :3].T + p[:, 3]
        if x[:, 2].min() < _NEAR:
            continue
        across = p[0, :3] - (p[0, :3] @ p[2, :3]) * p[2, :3]
        uv, per_metre = x[:, :2] / x[:, 2:], float(np.linalg.norm(across) / x[:, 2].mean())
        mask, codes = masks.masks[c, :h:step, :w:step] > 0, known.codes[c, :h:step, :w:step]
        shown, box = compute.shown_parts(vertices, faces, own, p / [[step], [step], [1]], mask.shape)
        for side in (0, 1):
            moved = _moved(shown, box, side, mask, codes, known.table[c], round(o.reach * per_metre / step), o)
            if moved is not None:
                at_once = slice(2 * side, 2 * side + 2)
                points[c, at_once, :2], points[c, at_once, 2] = uv[at_once] + step * moved, 1.0
                sizes.append(per_metre)
    if not sizes:
        return None
    return KeypointTerm(points, masks.projections, joint, offset, o.sd * float(np.median(sizes)), o.pull)


def _moved(
    shown: NDArray[np.uint8],
    box: tuple[slice, slice],
    side: int,
    mask: NDArray[np.bool_],
    codes: NDArray[np.uint16],
    table: NDArray[np.float32],
    reach: int,
    o: ColourSettings,
) -> Array | None:
    """(2,) px by which the hand of a side is to be moved, None where its colours are nowhere near."""
    hand, forearm = (shown[box] == 1 + part + 16 * side for part in (_HAND, _FOREARM))
    size = int(hand.sum())
    if size < o.least:
        return None
    x, y, wide, high = cv2.boundingRect((hand | forearm).view(np.uint8))
    hand, forearm = (cells[y : y + high, x : x + wide].astype(np.float32) for cells in (hand, forearm))
    h, w = shown.shape
    top, left = box[0].start + y - reach, box[1].start + x - reach
    pad = np.full((high + 2 * reach, wide + 2 * reach), -o.most, np.float32)
    ys, xs = slice(max(top, 0), min(top + len(pad), h)), slice(max(left, 0), min(left + pad.shape[1], w))
    inside = (slice(ys.start - top, ys.stop - top), slice(xs.start - left, xs.stop - left))
    mask, codes, there = mask[ys, xs], codes[ys, xs], shown[ys, xs]
    taken = (there == 1 + _HEAD) | (there == 1 + _HAND + 16 * (1 - side))  # these colours are explained
    total, hands = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32), None
    for part, cells in ((_HAND, hand), (_FOREARM, forearm)):
        field = pad.copy()
        field[inside] = np.where(mask, np.where(taken, 0.0, table[part][codes]), -o.most)
        found = cv2.matchTemplate(field, cells, cv2.TM_CCORR)
        hands = found if hands is None else hands
        total += found
    assert hands is not None
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1] / max(reach, 1)
    total -= o.stay * size * (u**2 + v**2).astype(np.float32)
    best = np.unravel_index(int(total.argmax()), total.shape)
    if hands[best] < o.told * size:
        return None
    return np.array([best[1] - reach, best[0] - reach], np.float64)


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
        colours, o = frame.frame.colours, self.settings
        if colours is None or frame.masks is None or h.weights.max() < o.surely:
            return memory
        body, (faces, part, arm) = frame.body, layout(frame.body)
        vertices = body.skin(pose)
        doubted = self._doubted(pose, h, body)
        for side in np.flatnonzero(doubted):
            part[arm == side] = len(PARTS)  # in front of others, but nothing to learn from
        use = frame.masks.usable & colours.seen
        found = np.zeros((len(use), len(PARTS), COLOURS), np.float32)
        for c in np.flatnonzero(use).tolist():
            w, height = frame.masks.sizes[c].tolist()
            shown, box = compute.shown_parts(vertices, faces, part, frame.masks.projections[c], (height, w))
            found[c] = counted_colours(shown[box], frame.masks.masks[c][box], colours.codes[c][box])
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


def layout(body: Body) -> tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.int64]]:
    """Faces of the coarse mesh, the part of each (F,), and its arm: 0 left, 1 right, -1 none."""
    names = body.skeleton.joint_names
    number = np.array([next((k for k, own in enumerate(PARTS) if n in own), 1) for n in names])
    side = np.array([next((k for k, own in enumerate(_ARMS) if n in own), -1) for n in names])
    joint = body.coarse.main_joint[body.coarse.faces]
    of_face = np.where(joint[:, 1] == joint[:, 2], joint[:, 1], joint[:, 0])
    return body.coarse.faces, number[of_face].astype(np.uint8), side[of_face]
