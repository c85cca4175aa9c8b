"""Frame: the evidence of one instant; every piece is optional and has its own type."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from hypose.cameras.camera import Camera, CameraRig
from hypose.compute.arrays import OUTLINE_POINTS, PreparedMasks, prepare_masks
from hypose.errors import EvidenceError, InputError
from hypose.evidence.depth_evidence import Depth
from hypose.evidence.outlines import WORKING_HEIGHT, Outlines, ViewOutline, stack_outlines, view_outline
from hypose.geometry import Array

_Piece = TypeVar("_Piece")
NOT_TRACKED, INFERRED, TRACKED = 0, 1, 2
"""States of a joint as sensors report them."""
MISSING_MARK = -9999.0
"""Value that loggers write for a missing coordinate; anything at or below it counts as missing."""
FARTHEST_M = 100.0
"""m: no depth sensor sees further; larger coordinates have another unit."""
LEAST_AREA = 200
"""px: least area by which a view's energy is divided, for a person of whom less is expected"""
ViewOutlines = list[ViewOutline | None]


@dataclass(frozen=True)
class Expected:
    """Expected place of a person in masks that show several people.

    boxes: (C, 4) box of the body in each view, y0, y1, x0, x1, half open, px.
    areas: (C,) pixels of its whole silhouette, including what others hide.
    """

    boxes: NDArray[np.int64]
    areas: NDArray[np.int64]


@dataclass(frozen=True)
class Silhouettes:
    """Masks of the person, one per view, undistorted (pinhole), at one working size.

    masks: (C, h, w) uint8, 1 = person; views of different size are padded with 0 to the common (h, w), see `rig.sizes`.
    rig: the pinhole cameras of these masks.
    usable: (C,) False for a view that is left out (empty, collapsed, or its camera delivered no frame).
    reasons: (C,) short text, "" when usable.
    ignored: (C, h, w) uint8, 1 = a pixel without information on this person, because another person's body covers it:
        neither mask nor "no mask". None: all pixels have information.
    expected: where this person is expected; needed where pixels are ignored, because masks of several people do not
        show how tall one of them is.
    owners: (C, h, w) for masks of several people: bit k of a pixel is set where it shows person k of its view; the
        numbers differ between views and frames. None: unknown.
    """

    masks: NDArray[np.uint8]
    rig: CameraRig
    usable: NDArray[np.bool_]
    reasons: tuple[str, ...]
    ignored: NDArray[np.uint8] | None = None
    expected: Expected | None = None
    owners: NDArray[np.uint8] | None = None
    _announced: list[Callable[[], ViewOutlines | None]] = field(
        default_factory=list, init=False, compare=False, repr=False
    )

    def announce_outlines(self, views: Callable[[], ViewOutlines | None], /) -> None:
        """Register a function that delivers the outlines of these masks, which other code is computing for tracking.

        views: function that waits for the outlines and returns one per view (None for a view without one), or returns
            None when no outlines will come.
        """
        self._announced.append(views)

    @cached_property
    def outlines(self) -> Outlines:
        """Outlines of the usable views for tracking, computed once: the announced ones, or else made now."""
        ready = [views for announced in self._announced if (views := announced()) is not None]
        return self.outlined(OUTLINE_POINTS, WORKING_HEIGHT, *ready)

    def outlined(
        self, count: int = OUTLINE_POINTS, working_height: int | None = None, ready: ViewOutlines | None = None
    ) -> Outlines:
        """Compute the outlines of the usable views.

        count: points per view.
        working_height: a mask taller than this is shrunk, px; None: it is not shrunk.
        ready: (C,) outlines that exist already; None for a view whose outline is missing.
        """
        made = ViewOutlines()
        for c, (w, h) in enumerate(self.rig.sizes.tolist()):
            view = None if ready is None or not self.usable[c] else ready[c]
            if self.usable[c] and view is None:
                hidden = ()
                if self.ignored is not None and self.expected is not None and self.shared[c]:
                    hidden = self.ignored[c, :h, :w], self.expected.boxes[c]
                view = view_outline(self.masks[c, :h, :w], count, working_height, *hidden)
            made.append(view)
        return stack_outlines(made, count)

    @cached_property
    def prepared(self) -> PreparedMasks:
        """The masks, prepared once for the silhouette scorer.

        A view without foreground is not usable, so nothing is divided by zero (Alcoverro 2014 does not say this after
        eq. 2.8).
        """
        norm = None
        if self.ignored is not None and self.expected is not None:
            norm = np.where(self.shared, np.maximum(self.expected.areas, LEAST_AREA), np.nan)
        given = self.masks, self.usable, self.rig.sizes, self.rig.projections, self.ignored
        made = prepare_masks(*given, norm)
        return made._replace(usable=made.usable & (made.areas > 0))

    def unseen(self) -> Silhouettes:
        """Copy the masks, mark all views as not usable, and remove the person's expected place."""
        reasons = tuple(r or f"{n}: no person is expected" for n, r in zip(self.rig.names, self.reasons, strict=True))
        return replace(self, usable=np.zeros_like(self.usable), reasons=reasons, ignored=None, expected=None)

    @cached_property
    def areas(self) -> NDArray[np.int64]:
        """Number of foreground pixels (C,) that are not ignored."""
        return np.array([np.count_nonzero(view) for view in self.informative], dtype=np.int64)

    @cached_property
    def shared(self) -> NDArray[np.bool_]:
        """Whether each view (C,) has ignored pixels, because other people cover them."""
        if self.ignored is None:
            return np.zeros(len(self.masks), dtype=np.bool_)
        return np.array([view.any() for view in self.ignored], dtype=np.bool_)

    @property
    def visible_share(self) -> Array:
        """Share of the person (C,) that others do not hide in each view; 0 where the view is not usable."""
        out = np.ones(len(self.rig))
        if self.ignored is not None and self.expected is not None:
            for c in np.flatnonzero(self.shared):
                y0, y1, x0, x1 = self.expected.boxes[c]
                own = self.masks[c, y0:y1, x0:x1]
                open_ = own & (1 - self.ignored[c, y0:y1, x0:x1])
                out[c] = min(1.0, np.count_nonzero(open_) / max(int(self.expected.areas[c]), 1))
        return np.where(self.usable, out, 0.0)

    @property
    def informative(self) -> NDArray[np.uint8]:
        """Masks (C, h, w) without ignored pixels."""
        return self.masks if self.ignored is None else np.greater(self.masks, self.ignored).view(np.uint8)


@dataclass(frozen=True)
class Keypoints:
    """2D key points of one person in every view.

    points: (C, K, 3) u px, v px, confidence 0..1, in undistorted pixels of `rig`; confidence 0 where missing.
    names: K key-point names (hypose.evidence.keypoints documents the sets).
    rig: pinhole cameras of these pixels.
    """

    points: Array
    names: tuple[str, ...]
    rig: CameraRig

    def unseen(self) -> Keypoints:
        """Copy the key points and set all confidences to 0."""
        return replace(self, points=np.zeros_like(self.points))


@dataclass(frozen=True)
class Detections:
    """Body ends that a detector found in one frame; the search moves particles to them.

    points: (M, 3) in the world, m.
    score: (M,) score of the detector.
    part: (M,) index of the part.
    """

    points: Array
    score: Array
    part: NDArray[np.int32]


@dataclass(frozen=True)
class SensorReport:
    """Skeleton of one person at one instant, as a depth sensor reports it.

    sensor: name.
    time: on the sensor's clock, s.
    arrival: on the receiving computer's clock, s, None: unknown.
    person: the sensor's number of the person; None when it sees no person (the arrays are empty).
    joint_names: (J,).
    positions: (J, 3) in the sensor's frame, m, NaN where missing.
    state: (J,) uint8, per joint: 0 not tracked, 1 inferred, 2 tracked.
    joint_depth: (J,) depth of the sensor's depth map at the joint's pixel, m, 0 = hole; None without depth maps.
    """

    sensor: str
    time: float
    person: int | None
    joint_names: tuple[str, ...]
    positions: Array
    state: NDArray[np.uint8]
    arrival: float | None = None
    joint_depth: Array | None = None


@dataclass(frozen=True)
class SensorJoints:
    """Skeletons of one person at one instant, one per depth sensor.

    positions: (K, J, 3) m, each in its own sensor's frame (or in a common frame after registration); NaN where missing.
    state: (K, J) uint8: 0 = not tracked, 1 = inferred, 2 = tracked; 0 where the position is missing.
    times: (K,) on the common clock, s; NaN for a sensor without a skeleton.
    joint_names: (J,).
    sensor_names: (K,).
    joint_depth: (K, J) depth of the sensor's depth map at the joint's pixel, m, 0 = hole; or None.
    The constructor makes all forms of "missing" (NaN, -9999, state 0) the same.
    Raises: InputError for wrong shapes and for positions that are not metres.
    """

    positions: Array
    state: NDArray[np.uint8]
    times: Array
    joint_names: tuple[str, ...]
    sensor_names: tuple[str, ...]
    joint_depth: Array | None = None

    def __post_init__(self) -> None:
        positions = np.array(self.positions, dtype=np.float64)
        state = np.array(self.state, dtype=np.uint8)
        times = np.array(self.times, dtype=np.float64)
        k, j = len(self.sensor_names), len(self.joint_names)
        if positions.shape != (k, j, 3) or state.shape != (k, j) or times.shape != (k,):
            raise InputError(
                f"Skeletons of {k} sensors, {j} joints, need positions {(k, j, 3)}, state {(k, j)} and times {(k,)}, "
                f"got {positions.shape}, {state.shape} and {times.shape}; all sensors must name the same joints."
            )
        if (state > TRACKED).any():
            raise InputError(f"A joint's state is 0, 1 or 2 (not tracked, inferred, tracked), got {int(state.max())}.")
        positions, state = clean_joints(positions, state, ", ".join(self.sensor_names), self.joint_names)
        for name, value in (("positions", positions), ("state", state), ("times", times)):
            object.__setattr__(self, name, value)
        if self.joint_depth is not None and np.shape(self.joint_depth) != (k, j):
            raise InputError(f"joint_depth needs shape {(k, j)}, got {np.shape(self.joint_depth)}.")


def clean_joints(
    positions: Array, state: NDArray[np.uint8], where: str, joint_names: Sequence[str]
) -> tuple[Array, NDArray[np.uint8]]:
    """Mark missing joints alike: NaN positions and state 0.

    positions: (..., J, 3) m.
    state: (..., J).
    where: sensor or file, for the message.
    Returns: copies of both.
    Raises: InputError for positions that are not metres.
    """
    positions, state = positions.copy(), state.copy()
    positions[(positions <= MISSING_MARK).any(-1)] = np.nan
    missing = ~np.isfinite(positions).all(-1) | (state == NOT_TRACKED)
    positions[missing], state[missing] = np.nan, NOT_TRACKED
    far = np.argwhere(np.abs(np.nan_to_num(positions)).max(-1, initial=0.0) > FARTHEST_M)
    if len(far):
        at = tuple(far[0])
        raise InputError(
            f"{where}: the joint {joint_names[at[-1]]} lies at {positions[at].round(1).tolist()}, which cannot be "
            f"metres (at most {FARTHEST_M:.0f}); divide millimetres by 1000."
        )
    return positions, state


@dataclass(frozen=True)
class Picture:
    """Picture of one camera.

    camera: pinhole camera of the same size.
    image: (h, w, 3) uint8 BGR, undistorted.
    before: the previous picture, None at the first.
    mask: (h, w), not 0 on the person; None: unknown.
    """

    camera: Camera
    image: NDArray[np.uint8]
    before: NDArray[np.uint8] | None = None
    mask: NDArray[np.uint8] | None = None

    @property
    def silhouettes(self) -> list[Silhouettes]:
        """The mask as silhouettes of one view: one element, or none where the mask is not known."""
        if self.mask is None:
            return []
        return [
            Silhouettes((self.mask != 0).astype(np.uint8)[None], CameraRig((self.camera,)), np.ones(1, bool), ("",))
        ]


@dataclass(frozen=True)
class Colours:
    """Colour codes of the pictures from which the masks were made (hypose.evidence.colours).

    codes: (C, h, w) colour code of each pixel of the masks (`colour_codes`); defined inside the person's masks only.
    seen: (C,) False for a view without a picture.
    edges: (C, 2, h, w) how fast colours change along rows and columns; None: not computed.
    """

    codes: NDArray[np.uint16]
    seen: NDArray[np.bool_]
    edges: NDArray[np.uint8] | None = None


@dataclass(frozen=True)
class Frame:
    """Evidence of one instant; each piece is None when the frame has none of this kind.

    time: s.
    index: frame number.
    more: pieces of further cues (`hypose.evidence.terms.Piece`), such as `examples/python/limb_maps.py`.
    """

    time: float
    index: int
    silhouettes: Silhouettes | None = None
    keypoints: Keypoints | None = None
    detections: Detections | None = None
    sensor_joints: SensorJoints | None = None
    picture: Picture | None = None
    colours: Colours | None = None
    depth: Depth | None = None
    more: tuple[Any, ...] = ()

    @property
    def pieces(self) -> dict[str, Any]:
        """Pieces of evidence that the frame has, by the names of their fields."""
        return {f.name: piece for f in fields(self)[2:-1] if (piece := getattr(self, f.name)) is not None}

    def of(self, kind: type[_Piece]) -> list[_Piece]:
        """List the piece of evidence of a class: one element, or none where the frame has no such piece."""
        return [piece for piece in (*self.pieces.values(), *self.more) if isinstance(piece, kind)]

    def the(self, kind: type[_Piece]) -> _Piece:
        """Return the frame's piece of evidence of a class.

        kind: class of the piece, for example Silhouettes.
        Raises: EvidenceError where the frame has no such piece.
        """
        for piece in self.of(kind):
            return piece
        raise EvidenceError(
            f"Frame {self.index} carries no {kind.__name__}; choose an evidence that the recording has."
        )

    def without(self, *kinds: type) -> Frame:
        """Copy the frame and leave out its pieces of evidence of some classes."""
        return replace(self, **{name: None for name, piece in self.pieces.items() if isinstance(piece, kinds)})

    def unseen(self) -> Frame:
        """Copy the frame and mark its masks, key points and depth maps as not usable, for a person who is not there."""
        seen = ("silhouettes", "keypoints", "depth")
        return replace(self, **{name: piece.unseen() for name, piece in self.pieces.items() if name in seen})

    @property
    def visible_share(self) -> Array:
        """Share of the person (C,) that others do not hide in each mask; (0,) without masks."""
        return np.zeros(0) if self.silhouettes is None else self.silhouettes.visible_share

    @property
    def kind(self) -> str:
        """Name of the kind of evidence by which a pose is judged: "depth" where the frame has depth, else
        "silhouettes", else "keypoints".
        """
        return next((name for name in ("depth", "silhouettes", "keypoints") if name in self.pieces), "keypoints")

    @property
    def fewest_views(self) -> int:
        """Number of views that must show a person to locate it: one depth camera, or two other cameras."""
        return 2 if self.depth is None else 1


def pieces_of(frames: Iterable[Frame], kind: type[_Piece]) -> list[_Piece]:
    """List the pieces of evidence of one class in several frames, in the order of the frames; frames without one are
    skipped.
    """
    return [piece for frame in frames for piece in frame.of(kind)]


class FrameSource(Protocol):
    """Protocol of a source of frames by number: hypose.io.recordings.frames.FrameStream, or a synthetic scene."""

    def __len__(self) -> int: ...

    def frame(self, index: int, /) -> Frame:
        """Return frame number index, 0 <= index < len."""
        ...
