"""Learn the colours of a person's parts view by view, and use them to find arms where masks cannot decide.

An arm in front of the trunk or behind it, or folded, or hanging next to the body, leaves the same outline, but its hand
and sleeve seldom have the same picture. So in frames without doubt the visible pixels of each part are counted by
colour; among rival poses, the one whose parts lie on their colours is better. Colours that are also those of the
background around them have no effect. In addition the edges of sleeves are compared. Arms are sampled around their
estimate with decreasing steps, and the best of masks and pictures holds the arm while the body is solved again.

The clothes of people (`AppearanceModel`) distinguish two people; nothing else does where they have one size and stand
at one place. The colours of trunk and legs are counted in all views together, because a person who turns round shows
the same shirt to another camera.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body
from hypose.compute import reach
from hypose.compute.arrays import PreparedMasks
from hypose.compute.part_colours import colour_sums, rim_edges, shown_parts
from hypose.evidence.colours import COLOURS, SHADES
from hypose.evidence.frame import Colours, Frame, Silhouettes
from hypose.evidence.terms import PointTerm
from hypose.geometry import Array
from hypose.inference.hypotheses import Hypotheses
from hypose.inference.layer import Memory
from hypose.tracking.arm_workspace import ArmReach
from hypose.tracking.frame_evidence import PreparedFrame, frame_energy


def pictured_arms(
    arms: Iterable[ArmReach], pose: Array, frame: PreparedFrame, settings: ColourSettings, rng: np.random.Generator
) -> tuple[Array, PointTerm] | None:
    """Move the arms of a pose (D,) to the best place nearby by masks and pictures.

    arms: tables of the arms; frame: prepared frame; its `memory` holds the colour counts learnt so far; settings:
        settings for colours.
    Returns: the pose (D,) and a term that holds the arms there in a solve; None when no colours are known, or nothing
        nearby is better.
    """
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
    at = body.skeleton.points(joint, offset, found)
    return found, PointTerm(at, np.full(len(joint), settings.strength), joint, offset, settings.hold)


def _one_arm(
    arm: ArmReach, pose: Array, frame: PreparedFrame, settings: ColourSettings, rng: np.random.Generator
) -> Array:
    """Move one arm of a pose (D,) to the best place nearby; return the same pose where it is the best.

    frame: prepared, with the counts in its memory; settings: settings for colours.
    """
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
"""Name of the colour counts (C, P, COLOURS) in the tracker's memory."""
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
"""Joints whose skin is one part; left and right have the same colours."""
_ARMS = tuple(tuple(f"{side}_{n}" for n in ("shoulder", "elbow", "wrist")) for side in ("left", "right"))
_CROSS = np.ones((3, 3), np.uint8)
_KERNEL = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32) / 16
"""Weights that spread the counts over neighbouring colours: noise, light and the threads of cloth vary them."""


@dataclass(frozen=True)
class ColourSettings:
    """Settings for learning colours and for their weight; chosen on folded arms of the seeds 503 and 505.

    surely: weight among its rivals that a pose must have to be learnt from.
    elsewhere: m, an arm is not learnt where a rival has it further away.
    memory: share of the previous counts that is kept in the next frame.
    few: number of pixels at which a part's own counts have half of the weight.
    most: largest log-likelihood ratio of one pixel.
    weight: weight of the pictures' score relative to the mismatch; edges: edges of the rims of arms relative to the
        colours.
    tried: rivals whose arms are searched nearby; draws: samples at each of the steps; steps: rad, sd.
    ratio: largest energy of a sample relative to that of the estimate.
    hold, strength: m (one sd) and weight of the points that hold the arms in a solve.
    """

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
    """Learnt colours of a person, and the colours in a frame.

    codes: (C, h, w) colour of each pixel.
    table: (C, P, COLOURS) log-likelihood ratios of each colour, in a part against anywhere on the person.
    masks: masks of the frame; only views with a picture are marked as usable.
    edges: per view (2, h, w) strength of the colour edges along rows and columns, as `rim_edges` returns it.
    """

    codes: NDArray[np.uint16]
    table: NDArray[np.float32]
    masks: PreparedMasks
    edges: tuple[NDArray[np.float32], ...]


def known_colours(frame: PreparedFrame, settings: ColourSettings) -> KnownColours | None:
    """Look up the known colours of a frame, cached in its `shared`; None where there is no picture, or nothing was
    learnt.

    frame: prepared frame; its `memory` holds the colour counts learnt so far; settings: settings for colours.
    """
    if "known colours" not in frame.shared:
        counts, masks, known = frame.memory.get(COUNTS), frame.silhouettes.masks, None
        for colours in frame.frame.of(Colours):
            seen = masks._replace(usable=masks.usable & colours.seen) if len(masks.usable) else masks
            if counts is not None and len(counts) == len(masks.masks) and seen.usable.any():
                table, edges = colour_table(counts, settings), rim_edges(seen, colours.edges)
                known = KnownColours(colours.codes, table, seen, edges)
        frame.shared["known colours"] = known
    return frame.shared["known colours"]


def colour_scores(poses: Array, frame: PreparedFrame, settings: ColourSettings) -> Array:
    """Compute how badly the colours and edges of the pictures fit poses (N, D); zeros where no colours are known.

    frame: prepared frame; its `memory` holds the colour counts learnt so far; settings: settings for colours.
    Returns: (N,) mean over the views of: the negative log-likelihood ratio (visible part against whole person), summed
        over the pixels and divided by the mask's area; plus the misfit of edges along the rims of arms in front of the
        body, divided by the square root of that area.
    """
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


def colour_table(counts: NDArray[np.float32], settings: ColourSettings) -> NDArray[np.float32]:
    """Compute the log-likelihood ratios (C, P, COLOURS) of each colour in a part against anywhere on the person.

    counts: (C, P, COLOURS) number of pixels; settings: settings for colours.
    """
    whole = counts.sum(1, keepdims=True)
    share = (whole + 1e-3) / (whole + 1e-3).sum(2, keepdims=True)
    of_part = (counts + settings.few * share) / (counts.sum(2, keepdims=True) + settings.few)
    return np.clip(np.log(of_part / share), -settings.most, settings.most).astype(np.float32)


def learn_colours(memory: Memory, pose: Array, h: Hypotheses, frame: PreparedFrame, /) -> Memory:
    """Learn the colours of the parts from a frame whose pose (D,) is certain; see `Recipe.learn`.

    h: the rivals and their weights; arms of which a rival is elsewhere are not learnt.
    Returns: the memory with the colours of the frame added.
    """
    o, body, masks = ColourSettings(), frame.body, frame.silhouettes.masks
    if not frame.silhouettes.seen or h.weights.max() < o.surely:
        return memory
    s, vertices, (faces, part, arm) = body.skeleton, body.skin(pose), part_layout(body)
    at = body.joints(np.concatenate([pose[None], h.values[h.weights > 0.02]]))
    for side, names in enumerate(_ARMS):
        ends = [s.joint(n) for n in names[1:]]
        if np.linalg.norm(at[1:, ends] - at[0, ends], axis=-1).max(initial=0.0) > o.elsewhere:
            part[arm == side] = len(PARTS)  # it hides other parts, but its colours are not learnt
    for colours in frame.frame.of(Colours):
        use = masks.usable & colours.seen
        found = np.zeros((len(use), len(PARTS), COLOURS), np.float32)
        for c in np.flatnonzero(use).tolist():
            w, height = masks.sizes[c].tolist()
            shown, box = shown_parts(vertices, faces, part, masks.projections[c], (height, w))
            found[c] = counted_colours(shown[box], masks.masks[c][box], colours.codes[c][box])
        before = memory.get(COUNTS)
        if before is not None and before.shape == found.shape:
            found = np.where(use[:, None, None], o.memory * before + found, before).astype(np.float32)
        memory = {**memory, COUNTS: found}
    return memory


def counted_colours(
    shown: NDArray[np.uint8], mask: NDArray[np.uint8], codes: NDArray[np.uint16]
) -> NDArray[np.float32]:
    """Count how often each part has each colour (P, COLOURS), away from the part's rim.

    shown: (h, w) number of the visible part plus 1, 0: none; mask: (h, w); codes: (h, w) colours.
    """
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
    """List the faces of the coarse mesh, the part of each (F,), and the arm of each (F,): 0 left, 1 right, -1 no
    arm.
    """
    names = body.skeleton.joint_names
    number = np.array([next((k for k, own in enumerate(PARTS) if n in own), 1) for n in names])
    side = np.array([next((k for k, own in enumerate(_ARMS) if n in own), -1) for n in names])
    of_face = body.coarse.face_joint
    return body.coarse.faces, number[of_face].astype(np.uint8), side[of_face]


# ---- clothes of people ----------------------------------------------------------------------------------------------


ZONES = ((1, 2), (5, 6))
"""Indices in part_colours.PARTS of each zone: trunk and sleeves, thighs and shanks."""
FEW = 150.0
"""Number of pixels that a zone must have shown to be compared."""


NO_CLOTHES = np.zeros((len(ZONES), COLOURS), np.float32)
"""Colour counts of the clothes of a person who has not been seen: (Z, COLOURS) pixels by zone (ZONES) and colour."""


def likeness(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """Compare the colours of clothes, (Z, COLOURS) counts each: 0 (no colour in common) to 1 (the same).

    Returns: mean over the zones of the Bhattacharyya coefficient of the colour distributions; NaN where no zone is
        known of both.
    """
    both = np.minimum(a.sum(1), b.sum(1)) >= FEW
    if not both.any():
        return float("nan")
    shares = [counts[both] / counts[both].sum(1, keepdims=True) for counts in (a, b)]
    return float(np.sqrt(shares[0] * shares[1]).sum(1).mean())


@dataclass(eq=False)
class AppearanceModel:
    """Appearance model of one person, to find out whether two people were exchanged after they met.

    worn: colours from before other people came near, (Z, COLOURS) pixels by zone (ZONES) and colour.
    lately: colours counted since other people came near, likewise.
    looks: number of frames in `lately`.
    met: names of the people who came near, with the frame in which they were nearest.
    """

    worn: NDArray[np.float32] = field(default_factory=lambda: NO_CLOTHES)
    lately: NDArray[np.float32] = field(default_factory=lambda: NO_CLOTHES)
    looks: int = 0
    met: dict[str, int] = field(default_factory=dict)

    def settle(self) -> None:
        """Accept that the person is still the same: add the colours `lately` to `worn`, and forget the meetings."""
        self.worn, self.lately, self.looks, self.met = self.worn + self.lately, NO_CLOTHES, 0, {}

    def arrays(self) -> dict[str, np.ndarray]:
        """Convert the colour counts to arrays for a checkpoint, which `of_arrays` reads."""
        return {"worn": self.worn, "lately": self.lately}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> AppearanceModel:
        """Restore the model from the values of a checkpoint.

        arrays: as `arrays` returned them.
        about: as the property `about` returned them.
        """
        return cls(arrays["worn"], arrays["lately"], int(about["looks"]), dict(about["met"]))

    @property
    def about(self) -> dict[str, Any]:
        """Values for a checkpoint that are not in `arrays`: `looks` and `met`, as JSON values."""
        return {"looks": self.looks, "met": self.met}


def appearance_in(body: Body, pose: Array, frame: Frame) -> NDArray[np.float32]:
    """Count the colours of a person's clothes in all views of a frame.

    pose: (D,) pose of the person in this frame.
    Returns: (Z, COLOURS) counts of the pixels in the mask that show trunk and legs and that no other person covers; all
        0 where the frame has no pictures.
    """
    out = NO_CLOTHES
    for s, colours in zip(frame.of(Silhouettes), frame.of(Colours), strict=False):
        vertices, (faces, part, _), given = body.skin(pose), part_layout(body), s.informative
        for c in np.flatnonzero(s.usable & colours.seen).tolist():
            w, h = s.rig[c].size
            shown, box = shown_parts(vertices, faces, part, s.rig.projections[c], (h, w))
            found = counted_colours(shown[box], given[c][box].astype(np.uint8), colours.codes[c][box])
            out = out + np.stack([found[list(zone)].sum(0) for zone in ZONES])
    return out
