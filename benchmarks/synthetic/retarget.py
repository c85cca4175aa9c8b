"""Captured motion (ASF/AMC skeleton files) on a subject: bone directions and turns are kept, proportions are
the subject's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from benchmarks.synthetic.asf import global_rotations, read_amc, read_asf
from hypose.errors import InputError
from hypose.geometry import Array, rotation_between, so3_exp, so3_log
from hypose.synthetic.performance import Performance, assemble, soles
from hypose.synthetic.subjects import SyntheticSubject

# CMU's files: y up, facing +z, x = the subject's left -> z up, facing -y
_WORLD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
# which bone of a CMU skeleton drives each of the 19 joints
_DRIVE = (
    *("root", "lowerback", "thorax", "lowerneck", "head"),
    *("lclavicle", "lhumerus", "lradius", "lradius", "rclavicle", "rhumerus", "rradius", "rradius"),
    *("lfemur", "ltibia", "lfoot", "rfemur", "rtibia", "rfoot"),
)


def retarget(
    asf: str | Path,
    amc: str | Path,
    subject: SyntheticSubject,
    frame_rate: float = 25.0,
    *,
    captured_rate: float = 120.0,
    start: float = 0.0,
    seconds: float | None = None,
    keep_trend: float = 0.25,
) -> Performance:
    """A CMU capture performed by the subject at frame_rate (Hz), about the origin of the world, facing as
    captured.

    Arms and legs point where the captured ones point (the rests of both skeletons are aligned bone by bone),
    trunk and head turn as the captured ones turn; the path is scaled by the legs' lengths. start, seconds:
    the part to take. keep_trend: share of the straight forward motion that is kept, so that somebody who
    walks through stays in the volume (as on a treadmill); 1 keeps all. The body stands on the ground (z = 0)
    with the subject's own feet.
    """
    skeleton, motion = read_asf(asf), read_amc(amc)
    position, rotations = global_rotations(skeleton, motion)
    missing = [b for b in set(_DRIVE) if b not in rotations]
    if missing:
        raise InputError(f"{asf} lacks the bones {', '.join(sorted(missing))}; give a skeleton with CMU's bone names.")
    n = len(position)
    last = (n - 1) / captured_rate
    end = last if seconds is None else min(last, start + seconds - 0.5 / frame_rate)
    if not 0 <= start < last:
        raise InputError(f"{amc} lasts {last:.1f} s; a start of {start:g} s lies outside.")
    times = np.arange(int(np.floor((end - start) * frame_rate)) + 1) / frame_rate
    at = (times + start) * captured_rate
    low = np.minimum(at.astype(int), n - 2)
    share = at - low

    def sampled(bone: str) -> Array:
        r = _WORLD @ rotations[bone] @ _WORLD.T
        step = so3_log(r[low + 1] @ np.swapaxes(r[low], -1, -2))
        return so3_exp(share[:, None] * step) @ r[low]

    align = _alignment(subject, {b: _WORLD @ skeleton.directions[skeleton.names.index(b)] for b in set(_DRIVE)})
    out = np.stack([sampled(b) @ align[j] for j, b in enumerate(_DRIVE)], 1)
    length = {b: skeleton.lengths[skeleton.names.index(b)] for b in ("lfemur", "ltibia")}
    path = (position @ _WORLD.T) * (subject.leg_length / sum(length.values()))
    root = path[low] + share[:, None] * (path[low + 1] - path[low])
    t = np.linspace(-0.5, 0.5, len(times))
    root[:, :2] -= root[:, :2].mean(0)
    if len(times) > 2:
        root[:, :2] -= (1 - keep_trend) * t[:, None] * np.polyfit(t, root[:, :2], 1)[0]
    root[:, :2] -= (root[:, :2].min(0) + root[:, :2].max(0)) / 2
    low_sole = soles(subject, out, subject.place_joints(out, root))[0].min(1)
    # In any 0.4 s of walking or running some foot is on the ground: the lower envelope of the soles is the
    # ground, so other feet and legs than the captured ones neither float nor sink, and flights stay flights.
    window = 2 * round(0.2 * frame_rate) + 1
    ground = gaussian_filter1d(minimum_filter1d(low_sole, window, mode="nearest"), 0.1 * frame_rate, mode="nearest")
    sunk = np.maximum(0.0, ground - low_sole)
    root[:, 2] += gaussian_filter1d(sunk, 0.04 * frame_rate, mode="nearest") - ground
    return assemble(Path(amc).stem, subject, times, out, root)


def _alignment(subject: SyntheticSubject, direction: dict[str, Array]) -> Array:
    """(19, 3, 3): from the subject's rest to the capture skeleton's rest, per joint."""
    j = subject.joints
    out = np.tile(np.eye(3), (len(j), 1, 1))
    for first, upper, lower in (
        (6, "lhumerus", "lradius"),
        (10, "rhumerus", "rradius"),
        (13, "lfemur", "ltibia"),
        (16, "rfemur", "rtibia"),
    ):
        a, b, c = first, first + 1, first + 2
        out[a] = rotation_between(j[b] - j[a], direction[upper])
        out[b] = rotation_between(out[a] @ (j[c] - j[b]), direction[lower]) @ out[a]
        out[c] = out[b]
    return out
