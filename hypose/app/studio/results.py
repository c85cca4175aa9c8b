"""Read results for the View screen: facts for lists, the block of bytes to show, pictures, thumbnails and gait."""

from __future__ import annotations

import json
import threading
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hypose.app.reports.summary import DESCRIPTIONS
from hypose.app.studio.catalog import Catalog, Item, NotFound
from hypose.app.studio.job_kinds import Plan
from hypose.app.studio.lru_cache import LruCache
from hypose.app.studio.recordings import Recordings
from hypose.app.studio.view_bundle import first_frame, in_recording, json_values, load_view, quality_of, view_bundle
from hypose.app.studio.view_pictures import OpenRecording
from hypose.body.skeleton import Skeleton
from hypose.errors import HyposeError
from hypose.geometry import Array, Image
from hypose.io.motions.results import Checkpoint, load_body, load_motion
from hypose.io.recordings.recording import load_recording
from hypose.pipeline.gait import angle_cycles, gait_of
from hypose.tracking.tracker import estimates_from_arrays, motion_of

_BLOCKS, _PICTURES, _THUMBNAILS, _GAITS = 24 << 20, 64 << 20, 4 << 20, 4 << 20
"""Most bytes of blocks, of open pictures, of thumbnails and of gait answers that are kept."""
_DESCRIBED = ("recording.toml", "Config.toml", "calibration.toml")
_MOTION = ("motion.npz", "body.npz")
_JUDGED = ("assessment.json", "modes.npz", "checkpoint.npz")
"""Files with a motion that show how good it is, and whether it is complete."""
_SIZE = (192, 144)
"""Width and height of a thumbnail, px."""
_ROOM = 1.35
"""Height of the thumbnail relative to that of the joints in it."""
_QUALITY = 82
_LEFT, _RIGHT, _MIDDLE = (74, 160, 245), (245, 178, 91), (247, 245, 242)  # BGR; as in View
Stamp = tuple[float | None, ...]


@dataclass(frozen=True)
class _Head:
    """Facts of a result for a list.

    stamp: times of change of its files when they were read (`_stamp`).
    facts: JSON values for the page.
    drawn: rows with their joints (J, 3) m, world, for the thumbnail, of which the first that has a picture is shown:
        the middle frame, and the first one for pictures that end before; empty where the motion cannot be read.
    skeleton: skeleton of the joints; None where the motion cannot be read.
    """

    stamp: Stamp
    facts: dict[str, Any]
    drawn: tuple[tuple[int, Array], ...] = ()
    skeleton: Skeleton | None = None


class Results:
    """Caches of what the View screen shows of results. Several threads may use them.

    A result is read again where its files have changed.
    catalog: items of the served folder.
    """

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog
        self._blocks: LruCache[bytearray] = LruCache(_BLOCKS, len)
        # four cameras of 1080p exceed the limit; the last used ones stay, since opening them takes seconds
        self._pictures: LruCache[OpenRecording] = LruCache(_PICTURES, lambda p: p.held, OpenRecording.close)
        self._thumbnails: LruCache[bytes] = LruCache(_THUMBNAILS, len)
        self._heads: dict[str, _Head] = {}
        self._gaits: LruCache[bytes] = LruCache(_GAITS, len)
        self._one = threading.Lock()  # one thread at a time loads a whole motion, since it is large

    def block(self, item: Item) -> bytearray:
        """Pack a result into the block of bytes that the View screen reads (layout: `view_bundle`).

        Returns: the block, from memory unless files of the result or of its recording have changed.
        """

        def make() -> bytearray:
            with self._one:
                return view_bundle(load_view(item.path))

        folder = self._catalog.recording_of(item.path)
        described = () if folder is None else _stamp(folder, (*_DESCRIBED, "truth.npz"))
        with self._blocks.use((item.id, _stamp(item.path, (*_JUDGED, *DESCRIPTIONS)), described), make) as block:
            return block

    def pictures(self, item: Item) -> AbstractContextManager[OpenRecording]:
        """Open the pictures of a result's recording, as a context; results of the same frames share them.

        Raises: NotFound where there is no recording.
        """
        folder = self._catalog.recording_of(item.path)
        if folder is None:
            raise NotFound("The result is in no recording's folder, so there are no pictures of it.")
        facts = self.head(item)  # the motion itself, which may be large, is not needed
        frames = facts["first_frame"], facts["first_frame"] + facts["frames"]
        return self._pictures.use(
            (folder, _stamp(folder, _DESCRIBED), *frames), lambda: OpenRecording(load_recording(folder), frames)
        )

    def head(self, item: Item) -> dict[str, Any]:
        """Return the facts of a result for the list of results: title, method, frames, rate and quality.

        Returns: JSON values; "frames" is 0 where the motion cannot be read.
        """
        return self._head(item).facts

    def _head(self, item: Item) -> _Head:
        """Return the facts of a result from memory; read them again where its files have changed."""
        stamp = _stamp(item.path, (*_MOTION, *_JUDGED))
        known = self._heads.get(item.id)  # without waiting for a thread that loads a motion
        if known is not None and known.stamp == stamp:
            return known
        with self._one:  # several simultaneous requests read the files only once
            if item.id not in self._heads or self._heads[item.id].stamp != stamp:
                self._heads[item.id] = self._read_head(item, stamp)
            return self._heads[item.id]

    def _read_head(self, item: Item, stamp: Stamp) -> _Head:
        """Read the facts of a result; "frames" is 0 where its motion cannot be read.

        item: the result.
        stamp: times of change of its files.
        """
        folder = self._catalog.recording_of(item.path)
        recipe, correctable, quality, first, drawn, skeleton = "unknown", False, {}, 0, (), None
        try:
            motion = load_motion(item.path / "motion.npz")
            frames, rate = len(motion), motion.frame_rate
            recipe = str(motion.provenance.get("recipe", recipe))
            first = first_frame(motion)
            correctable = folder is not None and motion.poses is not None and not (item.path / "modes.npz").exists()
            quality, skeleton = quality_of(item.path, motion), motion.skeleton
            seen = np.flatnonzero(np.isfinite(motion.joints).all((1, 2))).tolist()
            drawn = tuple((t, motion.joints[t].copy()) for t in (seen and [seen[len(seen) // 2], seen[0]]))
        except HyposeError:
            frames, rate = 0, 0.0
        facts = {
            "id": item.id,
            "title": f"{folder.name}: {item.path.name}" if folder is not None else item.path.name,
            "name": item.path.name,
            "path": self._catalog.shown(item.path),
            "recording": self._catalog.id_of("recording", folder) if folder is not None else None,
            "recipe": recipe,
            "frames": frames,
            "first_frame": first,
            "frame_rate": rate,
            "seconds": frames / rate if rate else 0.0,
            "complete": frames > 0 and not (item.path / "checkpoint.npz").exists(),
            "changed": stamp[0] or item.changed,
            "correctable": correctable,
            "pictured": folder is not None,
            **quality,
        }
        return _Head(stamp, facts, drawn, skeleton)

    def thumbnail(self, item: Item) -> bytes:
        """Make a JPEG of 192 x 144 px around the person in the middle frame, with the skeleton.

        Returns: the file's bytes. The picture is that of the first camera that has one; the first frame is shown where
            no camera has a picture of the middle one.
        Raises: NotFound where there are no pictures, or the motion cannot be read.
        """
        with self._thumbnails.use((item.id, _stamp(item.path)), lambda: self._thumbnail(item)) as data:
            return data

    def _thumbnail(self, item: Item) -> bytes:
        """Draw the thumbnail of a result; raise NotFound where its motion cannot be read or it has no pictures."""
        head = self._head(item)
        with self.pictures(item) as opened:
            for row, joints in head.drawn:
                if head.skeleton is not None and (found := opened.seen(row, joints)) is not None:
                    return _drawn(*found, head.skeleton)
        raise NotFound("There are no pictures of this result.")

    def gait(self, item: Item) -> bytes:
        """Compute the gait of a result and return it as the text of a JSON document, with the values of `gait_view`."""

        def make() -> bytes:
            with self._one:
                return json.dumps(json_values(gait_view(item.path))).encode()

        with self._gaits.use((item.id, _stamp(item.path)), make) as data:
            return data

    def so_far(self, plan: Plan, began: float | None, recordings: Recordings) -> bytearray | None:
        """Pack the frames that a job has tracked so far into the block of bytes that the View screen reads.

        The frames are those of the job's checkpoint; without a checkpoint, those of the finished result.
        plan: command of the job.
        began: time at which the job began, s since 1970; a result that is older belongs to another job. None: it has
            not begun.
        recordings: open recordings of the studio.
        Returns: the block (layout: `view_bundle`); None while there are no frames.
        Raises: NotFound where the job makes no motion, or its method keeps none that can be shown before the end.
        """
        folder = plan.folder
        if folder is None or plan.recording is None:
            raise NotFound("This job makes no motion.")
        recording = recordings.load(self._catalog.find("recording", plan.recording))
        checkpoint, motion = folder / "checkpoint.npz", folder / "motion.npz"
        if not checkpoint.is_file():
            if began is None or not motion.is_file() or motion.stat().st_mtime < began:
                return None
            return view_bundle(load_view(folder, recording))
        saved = Checkpoint.read(checkpoint)
        first_person = "0_done_"  # a checkpoint holds all people
        done = {k.removeprefix(first_person): v for k, v in saved.arrays.items() if k.startswith(first_person)}
        if not done:
            return None
        if not {"poses", "joint_covariances", "flags"} <= done.keys():
            raise NotFound("What this method has tracked so far cannot be shown; wait for its end.")
        estimates, body = estimates_from_arrays(done), load_body(folder / "body.npz")
        times = np.arange(len(estimates)) / recording.frame_rate
        frames = saved.identity.get("settings", {}).get("frames")
        tracked = motion_of(body, times, estimates, saved.identity)
        first = int(frames[0]) if frames else 0
        return view_bundle(in_recording(recording, tracked, body, first_frame=first, complete=False))

    def drop(self) -> None:
        """Empty the caches; values in use stay until they are released."""
        for kept in (self._gaits, self._thumbnails, self._pictures, self._blocks):
            kept.drop()


def _stamp(folder: Path, files: Sequence[str] = _MOTION) -> Stamp:
    """Return the times of change of files of a folder, to notice changes.

    Returns: s since 1970 by file; None where it does not exist. Of a checkpoint, which changes often, 0 stands for the
        time.
    """

    def written(name: str) -> float | None:
        try:
            at = (folder / name).stat().st_mtime
        except OSError:
            return None
        return 0.0 if name == "checkpoint.npz" else at

    return tuple(written(n) for n in files)


def _drawn(image: Image, points: Array, skeleton: Skeleton) -> bytes:
    """Cut the person out of a picture, draw the skeleton, and encode it as a JPEG of _SIZE.

    image: (h, w, 3) BGR.
    points: (J, 2) px, joints; NaN where not known.
    skeleton: skeleton of the joints.
    """
    h, w = image.shape[:2]
    inside = points[np.isfinite(points).all(1)]
    low, high = (inside.min(0), inside.max(0)) if len(inside) else (np.zeros(2), np.array([w, h], dtype=float))
    across, up = (_ROOM * (high - low)).tolist()
    tall = min(float(h), max(24.0, up, across * _SIZE[1] / _SIZE[0]))
    wide = min(float(w), tall * _SIZE[0] / _SIZE[1])
    tall = wide * _SIZE[1] / _SIZE[0]
    corner = np.clip((low + high) / 2 - (wide / 2, tall / 2), 0, np.maximum((w - wide, h - tall), 0))
    scale = _SIZE[0] / wide
    cut = np.array([[scale, 0, -scale * corner[0]], [0, scale, -scale * corner[1]]])
    small = cv2.warpAffine(image, cut, _SIZE, flags=cv2.INTER_AREA)
    at = scale * (points - corner)
    names = skeleton.joint_names
    for joint, parent in enumerate(skeleton.parents):
        if parent < 0 or not np.isfinite(at[[joint, parent]]).all():
            continue
        a, b = ((round(float(x)), round(float(y))) for x, y in at[[parent, joint]])
        colour = _LEFT if names[joint].startswith("left") else _RIGHT if names[joint].startswith("right") else _MIDDLE
        cv2.line(small, a, b, (20, 20, 20), 4, cv2.LINE_AA)
        cv2.line(small, a, b, colour, 2, cv2.LINE_AA)
    return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()


NO_GAIT: dict[str, Any] = {"events": [], "figures": [], "cycles": []}


def gait_view(results: Path) -> dict[str, Any]:
    """Compute the gait of a result for the page.

    results: folder of the result.
    Returns: table of lists: "events" (time in s, side, kind), "figures" (name, unit, mean, low, high, number), and
        "cycles" (of each joint angle the mean and standard deviation in degrees, from 0 to 100 % of the cycle). All
        are empty where the person does not walk, or the motion has no poses or no body.
    """
    try:
        motion, body = load_motion(results / "motion.npz"), load_body(results / "body.npz")
        if motion.poses is None or body.skeleton.joint_names != motion.skeleton.joint_names:
            return NO_GAIT
        found = gait_of(motion, body)
    except HyposeError:
        return NO_GAIT
    return {
        "events": [{"time": e.time, "side": e.side, "kind": e.kind} for e in found.events],
        "figures": [
            {"name": f.name, "unit": f.unit, "mean": f.mean, "low": f.low, "high": f.high, "n": f.n}
            for f in found.figures
        ],
        "cycles": [
            {"name": c.name, "mean": np.degrees(c.mean), "sd": np.degrees(c.sd), "n": c.n}
            for c in angle_cycles(found.events, motion)
        ],
    }
