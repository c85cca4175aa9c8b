"""Two people before depth cameras who walk past each other, and each of them alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.multiview.action_scenes import subject_of_seed
from benchmarks.synthetic.depth_frames import depth_frames
from hypose.body.motion import Motion
from hypose.geometry import Array
from hypose.pipeline.people_run import PeopleRun
from hypose.pipeline.run import track_source
from hypose.pipeline.track_loop import FrameList
from hypose.pipeline.track_options import TrackOptions
from hypose.synthetic.depth_scenes import DepthScene, depth_scene, turning
from hypose.synthetic.metrics import EVALUATED
from hypose.synthetic.motions import act
from hypose.synthetic.performance import assemble
from hypose.synthetic.subjects import dress

JointsOf = Callable[[Motion, DepthScene], Array]
"""(T, J, 3) m: the joints of a motion as a scene defines them"""
_SPEED, _ASIDE_M = 1.1, 0.4
"""m/s, and m beside the middle on which each of them walks"""
_LOST_M = 0.25
"""m: mean error of a frame in which a track is somebody else's, or nobody's"""


def passing(seed: int, sensors: str, seconds: float, rate: float) -> list[DepthScene]:
    """Two scenes of the same instants: somebody alone who walks along x, and somebody who comes towards them."""
    scenes = []
    for k, way in enumerate((1.0, -1.0)):
        subject = dress(subject_of_seed(seed + 1000 * k), 0.02, np.random.default_rng([seed, k]))
        p = act("walk", subject, seconds, rate, np.random.default_rng([seed, 5 + k]))
        p = turning(p, subject, np.full(len(p), way * np.pi / 2))
        at = p.root * [0, 0, 1] + [0, -_ASIDE_M * way, 0]
        at[:, 0] += way * _SPEED * (p.times - p.times.mean())
        scenes.append(depth_scene(assemble(p.name, subject, p.times, p.rotations, at), subject, sensors, seed=seed))
    return scenes


def people_apart(
    seed: int, sensors: str, seconds: float, rate: float, joints_of: JointsOf, empty: bool = True
) -> dict[str, float]:
    """together_mm, alone_mm: mean error of both when they are tracked together, and each alone; exchanged: share of
    the frames in which a track is not its person's; invented: people beyond the two. empty: the empty room was
    recorded."""
    alone = passing(seed, sensors, seconds, rate)
    first, second = alone
    both = replace(first, others=((second.subject, second.performance),))
    options = TrackOptions(seed=seed)
    found = PeopleRun(FrameList(list(depth_frames(both, True, empty)), rate), rate, options)().people
    out = {"invented": float(max(len(found) - 2, 0)), "together_mm": 1000.0, "exchanged": 1.0}
    errors = np.array([[_away(p.result.motion, s, joints_of) for p in found] for s in alone])
    if len(found) >= 2:
        mine = errors.mean(-1).argmin(1)
        own = errors[[0, 1], mine]
        if mine[0] != mine[1]:
            out |= {"together_mm": 1e3 * float(own.mean()), "exchanged": float((own > _LOST_M).mean())}
    by_themselves = [
        track_source(FrameList(list(depth_frames(s, empty=empty)), rate), rate, options).motion for s in alone
    ]
    out["alone_mm"] = 1e3 * float(np.mean([_away(m, s, joints_of) for m, s in zip(by_themselves, alone, strict=True)]))
    return out


def _away(motion: Motion, scene: DepthScene, joints_of: JointsOf) -> Array:
    """(T,) m: mean error of each frame."""
    return np.linalg.norm(scene.joints - joints_of(motion, scene), axis=-1)[:, EVALUATED].mean(1)
