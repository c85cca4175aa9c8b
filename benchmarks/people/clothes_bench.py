"""`bench clothes`: people of one body whom place, motion and size do not tell apart, with the pictures and without.

Twins in clothes that are drawn by lot: one leaves and the other comes to the same place a second later; or both leave,
and each comes back where the other one stood.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.multiview.action_scenes import subject_of_seed
from benchmarks.people.together import out_of_view
from benchmarks.synthetic.noisy_masks import noisy_scene
from hypose.evidence.colours import colour_codes
from hypose.evidence.frame import Colours, Frame
from hypose.geometry import Array
from hypose.pipeline.run import TrackResult
from hypose.pipeline.sources import FrameList
from hypose.pipeline.track import track_people
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.motions import act
from hypose.synthetic.performance import Performance
from hypose.synthetic.scenes import Scene

FIRST_SEED = 330
RATE = 25.0
SETTINGS = {"another comes": 3.2, "places exchanged": 3.2}
"""s of each."""
_ASKED = {"another comes": 1, "places exchanged": 2}
"""People who are there at the end."""
_LEAVES, _COMES, _BESIDE_M, _HERE_M = 1.0, 2.0, 0.6, 0.5


def clothes(options: BenchOptions) -> BenchReport:
    """Rows wrong (SETTING/pictures, SETTING/masks alone: people who, in the last third of a second, are tracked under
    the name of somebody else, or of nobody), n: people."""
    seeds = options.seed_range(3, first=FIRST_SEED)
    found: dict[str, list[Mapping[str, Any]]] = {}
    for k, setting in enumerate(SETTINGS):
        for n, seed in enumerate(seeds):
            options.progress(f"{setting}, seed {seed}", k * len(seeds) + n, len(SETTINGS) * len(seeds))
            part = options.part(f"clothes.{setting.replace(' ', '-')}.{seed}", partial(run, setting, seed))
            found.setdefault(setting, []).append(part)
    options.progress("done", 1, 1)
    rows = [
        Row("wrong", f"{setting}/{case}", float(sum(p[case] for p in parts)), "people", n=_ASKED[setting] * len(parts))
        for setting, parts in found.items()
        for case in ("pictures", "masks alone")
    ]
    return BenchReport(tuple(rows), {"seeds": len(seeds), "first_seed": seeds.start, "rig": "ring-5"})


def run(setting: str, seed: int) -> dict[str, Any]:
    """How many of the two are who they are not at the end, tracked with and without pictures."""
    scene, there = _twins(setting, seed)
    plain = list(scene.mask_frames(1.0))
    frames = [_with_colours(scene, f) for f in plain]
    roots = np.stack([p.root[: len(plain), :2] for p in (scene.performance, *(p for _, p in scene.others))])
    out = {}
    for case, given in (("pictures", frames), ("masks alone", plain)):
        people = track_people(FrameList(given, RATE), RATE, TrackOptions(evidence="silhouettes")).people
        out[case] = _wrong(people, roots, there)
    return out


def _twins(setting: str, seed: int) -> tuple[Scene, NDArray[np.bool_]]:
    """The scene (who is first is in it all the time, or leaves), and when each of the two is there (2, T)."""
    seconds, twin = SETTINGS[setting], subject_of_seed(3 * seed + 1)
    rng = np.random.default_rng([seed, 17])
    if setting == "another comes":
        one = other = act("wave", twin, seconds, RATE, rng)
        there = np.stack([one.times < _LEAVES, one.times >= _COMES])
    else:
        here = act("wave", twin, seconds, RATE, rng)
        back = here.times >= _COMES
        side = np.where(back, _BESIDE_M, -_BESIDE_M)
        one, other = _shifted(here, side), _shifted(here, -side)
        there = np.tile(back | (here.times < _LEAVES), (2, 1))
    scene = noisy_scene(one, twin, "ring-5", seed=seed)
    first, second = (out_of_view(p, ~t) for p, t in zip((one, other), there, strict=True))
    return replace(scene, performance=first, others=((scene.subject, second),)), there


def _shifted(p: Performance, x: Array) -> Performance:
    """Somebody x (T,) m further along the first axis."""
    root, joints = p.root.copy(), p.joints.copy()
    root[:, 0] += x
    joints[..., 0] += x[:, None]
    return Performance(p.name, p.times, p.rotations, root, joints)


def _with_colours(scene: Scene, frame: Frame) -> Frame:
    s = frame.silhouettes
    assert s is not None
    codes = np.stack([colour_codes(scene.rgb_frame(c, frame.index)) for c in range(len(s.rig))])
    shown = np.where(s.masks > 0, codes, 0).astype(np.uint16)
    return replace(frame, colours=Colours(shown, np.ones(len(s.rig), dtype=bool)))


def _wrong(people: tuple[TrackResult, ...], roots: Array, there: NDArray[np.bool_]) -> int:
    """How many of the two (roots (2, T, 2) m) nobody is at the end, or somebody who was the other one at first."""
    wrong, end = 0, len(roots[0]) - round(RATE / 3)
    for k, (root, when) in enumerate(zip(roots, there, strict=True)):
        frames = [t for t in range(end, len(root)) if when[t]]
        if not frames:
            continue  # who has left is not asked for
        own = [p for p in people if p.there[frames].all() and _at(p, root, frames)]
        first = [t for t in range(round(0.4 * RATE)) if there[1 - k][t]]
        was_other = [bool(first) and p.there[first].all() and _at(p, roots[1 - k], first) for p in own]
        wrong += not own or any(was_other)
    return wrong


def _at(person: TrackResult, root: Array, frames: list[int]) -> bool:
    at = person.motion.joints[frames, 0, :2]
    return bool(np.median(np.linalg.norm(at - root[frames], axis=1)) < _HERE_M)
