"""Draw results on the recorded images of all views: body, skeleton and mask, arranged in tiles.

Points are projected with the lens distortion of the calibration and the view's image_shift onto the recorded images; so
a body that is off in the picture is off in the result.
"""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.app.commands.console import ProgressCall, ignore
from hypose.body.body import Body, Mesh
from hypose.body.motion import Motion
from hypose.body.skeleton import Skeleton
from hypose.cameras.camera import Camera
from hypose.compute.parts import covered, projected
from hypose.errors import InputError, visible
from hypose.evidence.frame import Silhouettes
from hypose.geometry import Array, Image
from hypose.io.recordings.object_masks import ObjectMasks
from hypose.io.recordings.recording import Recording, ViewSettings
from hypose.io.recordings.recording_views import open_pictures
from hypose.io.videos.video import VideoReader, writing_video
from hypose.pipeline.sources import FrameSource

# BGR; also different for people with red-green colour blindness
_LEFT, _RIGHT, _MIDDLE = (40, 130, 240), (225, 140, 40), (235, 235, 235)
BODY, _MASK, ALARM = (200, 190, 60), (190, 90, 230), (40, 40, 230)
MAX_TILE, MAX_WIDTH = 720, 1440
_BAR, _GREY = 26, 24
_SMALL = 640 * 480


def tile_layout(sizes: Sequence[tuple[int, int]]) -> tuple[list[tuple[int, int, int, int]], tuple[int, int]]:
    """Arrange the views in tiles below a title bar, each at most 720 px wide and all together 1440 px.

    sizes: (width, height) sizes of the recorded pictures, px.
    Returns: (x, y, width, height) px of each view in the picture, and (width, height) px of the picture before it is
        cut to even numbers, which videos need.
    """
    columns = math.ceil(math.sqrt(len(sizes))) if len(sizes) != 3 else 3
    width, shown = min(MAX_TILE, MAX_WIDTH // columns), []
    for w, h in sizes:
        scale = min(1.0, width / w, MAX_TILE / h)
        shown.append((max(2, round(w * scale)), max(2, round(h * scale))))
    cell_w, cell_h = max(w for w, _ in shown), max(h for _, h in shown)
    boxes = [
        (i % columns * cell_w + (cell_w - w) // 2, _BAR + i // columns * cell_h + (cell_h - h) // 2, w, h)
        for i, (w, h) in enumerate(shown)
    ]
    return boxes, (columns * cell_w, _BAR + math.ceil(len(sizes) / columns) * cell_h)


class ViewImages:
    """Recorded pictures of one view by frame number, to be read forwards; grey pictures of the masks where the view has
    only masks.

    view, camera: the view and its calibrated camera.
    jumps: frames are read in any order (`VideoReader.jumps`).

    Attributes:
    size: (width, height) of the pictures, px.
    """

    def __init__(self, view: ViewSettings, camera: Camera, jumps: bool = False) -> None:
        self.view, self.camera = view, camera
        # with small pictures several threads are no faster, and slow down the one that writes the video
        threads = 1 if math.prod(camera.size) <= _SMALL else None
        self.reader: VideoReader | ObjectMasks | None = open_pictures(view, threads) if view.has_pictures else None
        if isinstance(self.reader, VideoReader):
            self.reader.jumps = jumps
        self.size: tuple[int, int] = self.reader.size if self.reader is not None else camera.size
        self._memory: Image | None = None

    def read(self, index: int) -> Image | None:
        """Read the picture of a frame, valid until the next one is read.

        index: number of the video's frame.
        Returns: (h, w, 3) BGR; None where the view has no pictures, ends before the frame, or the frame is damaged.
        """
        if self.reader is None or not 0 <= index < self.reader.n_frames:
            return None
        try:
            if isinstance(self.reader, VideoReader):
                image = self._memory = self.reader.read(index, self._memory)
            else:
                image = self.reader.read(index)
        except InputError:  # tracking has left out this frame of the view and reported it
            return None
        return image if self.view.source is not None else (image // 3 + 40).astype(np.uint8)

    def close(self) -> None:
        """Release the file."""
        if self.reader is not None:
            self.reader.close()


@contextlib.contextmanager
def open_images(recording: Recording) -> Iterator[list[ViewImages]]:
    """Open the recorded pictures of all views of a recording; they are closed when the `with` block ends."""
    with contextlib.ExitStack() as stack:
        views = zip(recording.views, recording.rig, strict=True)
        yield [stack.enter_context(contextlib.closing(ViewImages(v, c))) for v, c in views]


def as_shown(view: ViewSettings, camera: Camera, size: tuple[int, int]) -> Camera:
    """Compute the camera, with its lens, whose pixels are those of the recorded image shown at a size.

    view: gives the offset of the recorded image (image_shift).
    camera: calibrated camera of the view.
    size: (width, height) px at which the image is shown.
    """
    shown = camera.scaled(size)
    shown.K[:2, 2] -= np.asarray(view.image_shift) * size / camera.size
    return shown


def mask_outline(camera: Camera, working: Camera, mask: NDArray[np.uint8]) -> list[NDArray[np.int32]]:
    """Convert the outlines of an undistorted mask to polygons in a picture with lens distortion.

    camera: camera of the shown picture, with its lens (`as_shown`).
    working: the same camera without distortion, at the working size; its pixels are those of the mask.
    mask: (h, w), not 0 inside the person; pixels beyond the size of `working` are not used.
    Returns: (N, 1, 2) polygons in 1/16 px, as OpenCV draws them; empty for an empty mask.
    """
    w, h = working.size
    x, y, width, height = cv2.boundingRect(mask[:h, :w])  # an empty mask costs OpenCV as much
    if not width:
        return []
    window = np.ascontiguousarray(mask[y : y + height, x : x + width])
    centre, focal, out = working.K[:2, 2], np.diag(working.K)[:2], []
    for contour in cv2.findContours(window, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE, offset=(x, y))[0]:
        uv = camera.through_lens((contour[:, 0] - centre) / focal)
        if len(uv) > 2 and np.isfinite(uv).all():
            out.append(_fixed(uv))
    return out


_SHIFT = 4  # OpenCV draws at 1/16 px


def _fixed(uv: Array) -> NDArray[np.int32]:
    return np.clip(np.rint(uv * 2**_SHIFT), -(2**24), 2**24).astype(np.int32)[:, None]


def draw_body(image: Image, camera: Camera, vertices: Array, mesh: Mesh, colour: tuple[int, int, int] = BODY) -> None:
    """Draw the silhouette of a mesh as a tint with a bright edge; nothing where the body reaches behind the camera.

    image: (h, w, 3) BGR picture that is changed.
    camera: camera whose pixels are those of the image (`as_shown`).
    vertices: (V, 3) m, world.
    mesh: mesh with the faces of the vertices.
    colour: BGR.
    """
    directions, depth, _ = projected(vertices, camera.camera_from_world[:3])
    uv = camera.through_lens(directions)
    across, down = np.ascontiguousarray(uv.T)
    reach = np.array([[across.min(), down.min()], [across.max(), down.max()]])
    if not np.isfinite(reach).all():
        return  # the body reaches behind the camera and cannot be drawn
    (x, y), (right, bottom) = np.clip(np.floor(reach) + [[0], [2]], 0, camera.size).astype(int).tolist()
    if x == right or y == bottom:
        return
    shape = covered(uv - [x, y], depth, mesh.faces, (bottom - y, right - x), closed=True)
    window = image[y:bottom, x:right]
    plain = cv2.repeat(np.array([[colour]], np.uint8), bottom - y, right - x)
    # sums of twentieths, rounded down; looking them up (cv2.LUT) takes three times as long
    cv2.copyTo(cv2.addWeighted(window, 0.65, plain, 0.35, -0.475), shape, window)
    edges = cv2.findContours(shape, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE, offset=(x, y))[0]
    cv2.polylines(image, edges, True, colour, 1, cv2.LINE_AA)


def jpeg(image: Image, width: int, quality: int = 82) -> bytes:
    """Encode a picture as JPEG, at most `width` px wide; quality: 0 to 100."""
    h, w = image.shape[:2]
    if w > width:
        image = np.asarray(
            cv2.resize(image, (width, max(1, round(h * width / w))), interpolation=cv2.INTER_AREA), np.uint8
        )
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def draw_skeleton(image: Image, camera: Camera, skeleton: Skeleton, joints: Array) -> None:
    """Draw bones between joint centres: the left side orange, the right side blue, the middle white.

    image: (h, w, 3) BGR picture that is changed.
    camera: camera whose pixels are those of the image (`as_shown`).
    skeleton: gives the names and parents of the joints.
    joints: (J, 3) m, world; bones to joints that are NaN or behind the camera are left out.
    """
    uv = camera.project(joints)
    width = 2 if max(camera.size) > 480 else 1
    seen = np.isfinite(uv.sum(1))
    uv[~seen] = 0
    at = _fixed(uv)[:, 0].tolist()
    for b, (name, a) in enumerate(zip(skeleton.joint_names, skeleton.parents.tolist(), strict=True)):
        if a >= 0 and seen[a] and seen[b]:
            colour = _LEFT if name.startswith("left") else _RIGHT if name.startswith("right") else _MIDDLE
            cv2.line(image, at[a], at[b], (20, 20, 20), width + 2, cv2.LINE_AA, _SHIFT)
            cv2.line(image, at[a], at[b], colour, width, cv2.LINE_AA, _SHIFT)


def put_text(image: Image, text: str, x: int, y: int, colour: tuple[int, int, int] = (255, 255, 255)) -> None:
    """Write a text with a dark outline.

    image: picture that is changed.
    x, y: left end of the base line, px.
    colour: BGR.
    """
    font, size, text = cv2.FONT_HERSHEY_SIMPLEX, 0.5, visible(text)  # invalid UTF-8 would kill OpenCV
    for dx, dy in ((-1, 0), (1, 0), (0, -1), (0, 1)):  # a thicker stroke would be wider in OpenCV 5, hence no rim
        cv2.putText(image, text, (x + dx, y + dy), font, size, (0, 0, 0), 1, cv2.LINE_AA)
    cv2.putText(image, text, (x, y), font, size, colour, 1, cv2.LINE_AA)


@dataclass(frozen=True)
class DrawnBody:
    """Body of one person in one frame.

    vertices, joints: (V, 3) of the body's fine mesh and (J, 3), m, world.
    colour: BGR.
    """

    body: Body
    vertices: Array
    joints: Array
    colour: tuple[int, int, int] = BODY


@dataclass(frozen=True)
class Drawing:
    """Content of one frame to draw.

    silhouettes: masks of the frame; None: not drawn.
    title: text of the title bar.
    people: bodies to draw.
    alarm: whether the title bar is red.
    """

    silhouettes: Silhouettes | None
    title: str
    people: tuple[DrawnBody, ...] = ()
    alarm: bool = False


def draw_view(out: Image, image: Image | None, camera: Camera, index: int, what: Drawing) -> None:
    """Draw one view of a frame into a picture: the recorded image, tinted bodies, outline of the mask, skeletons.

    out: (h, w, 3) BGR picture that is overwritten.
    image: recorded picture (BGR) of any size; None: the view has none, and the text "no image" on grey takes its place.
    camera: camera whose pixels are those of `out` (`as_shown`).
    index: index of the view, which selects the mask in `what.silhouettes`.
    what: content of the frame; its title is not used.
    """
    if image is None:
        out[:] = 40
        put_text(out, "no image", 8, len(out) // 2)
    elif image.shape != out.shape:
        how = cv2.INTER_AREA if out.shape[1] < image.shape[1] else cv2.INTER_LINEAR
        cv2.resize(image, camera.size, out, interpolation=how)
    else:
        out[:] = image
    for person in what.people:
        draw_body(out, camera, person.vertices, person.body.fine, person.colour)
    s = what.silhouettes
    if s is not None:
        outlines = mask_outline(camera, s.rig[index], s.masks[index])
        cv2.polylines(out, outlines, True, _MASK, 1, cv2.LINE_AA, _SHIFT)
    for person in what.people:
        draw_skeleton(out, camera, person.body.skeleton, person.joints)


def _write_labels(shown: Image, view: ViewSettings, index: int, what: Drawing) -> None:
    put_text(shown, view.name, 6, 18)
    s = what.silhouettes
    if s is not None and not s.usable[index]:
        reason = (s.reasons[index] or "no reason given").split(": ", 1)[-1].split(" (")[0]
        put_text(shown, f"left out: {reason}"[:70], 6, shown.shape[0] - 8, (120, 140, 255))


class Canvas:
    """Memory for a picture of all views under a title bar; a picture is valid until the next one is drawn.

    recording: gives the views and cameras.
    images: pictures of the views, whose sizes give the layout (`tile_layout`).

    Attributes:
    size: (width, height) of the picture, px, both even.
    """

    def __init__(self, recording: Recording, images: Sequence[ViewImages]) -> None:
        boxes, (w, h) = tile_layout([v.size for v in images])
        self._views, self.size = recording.views, (w // 2 * 2, h // 2 * 2)
        self._whole = np.full((h, w, 3), _GREY, np.uint8)
        self._tiles = [self._whole[y : y + th, x : x + tw] for x, y, tw, th in boxes]
        about = zip(recording.views, recording.rig, boxes, strict=True)
        self._cameras = [as_shown(view, camera, box[2:]) for view, camera, box in about]

    def draw(self, images: Sequence[Image | None], what: Drawing) -> Image:
        """Draw all views of one frame under the title bar.

        images: recorded pictures by view; None where there is none.
        what: content of the frame.
        Returns: (h, w, 3) BGR of `size`, valid until the next call.
        """
        for c, (image, tile, camera) in enumerate(zip(images, self._tiles, self._cameras, strict=True)):
            draw_view(tile, image, camera, c, what)
            _write_labels(tile, self._views[c], c, what)
        self._whole[:_BAR] = (30, 30, 150) if what.alarm else _GREY
        put_text(self._whole, what.title, 8, 18)
        return self._whole[: self.size[1], : self.size[0]]


def close_up(
    image: Image, camera: Camera, points: Array, size: tuple[int, int], room: float = 1.2
) -> tuple[Image, Camera]:
    """Cut a picture to the person.

    image: (h, w, 3) BGR.
    camera: camera whose pixels are those of the image.
    points: (N, 3) m, world, of the person; the whole picture is shown where none of them is in front of the camera.
    size: (width, height) size of the cut picture, px.
    room: size of the part that is shown, relative to that of the points.
    Returns: the cut picture, grey beyond the borders of the image, and the camera whose pixels are those of it.
    """
    uv = camera.project(points)
    uv = uv[np.isfinite(uv).all(1)]
    low, high = (uv.min(0), uv.max(0)) if len(uv) else (np.zeros(2), np.array(camera.size, dtype=float))
    scale = float(np.clip((size / np.maximum(room * (high - low), 1.0)).min(), 0.1, 2.5))
    corner = (low + high) / 2 - np.array(size) / (2 * scale)
    cut = np.array([[scale, 0, -scale * corner[0]], [0, scale, -scale * corner[1]], [0, 0, 1]])
    near = cv2.warpAffine(image, cut[:2], size, flags=cv2.INTER_AREA, borderValue=(40, 40, 40))
    return np.asarray(near, np.uint8), replace(camera, K=cut @ camera.K, size=size)


def draw_close_ups(images: Sequence[Image | None], recording: Recording, what: Drawing) -> Image:
    """Draw every view of one frame, cut to a square of 300 px around the first person, in rows of four squares.

    images: recorded pictures by view; None where there is none.
    what: content of the frame.
    Returns: (h, w, 3) BGR; the square of a view is grey without a picture, or without a person in `what`.
    """
    side = 300
    cells = []
    for c, (image, view, camera) in enumerate(zip(images, recording.views, recording.rig, strict=True)):
        cell = np.full((side, side, 3), 40, np.uint8)
        if image is not None and what.people:
            shown = as_shown(view, camera, image.shape[1::-1])
            near, cut = close_up(image, shown, what.people[0].vertices, (side, side))
            draw_view(cell, near, cut, c, what)
        _write_labels(cell, view, c, what)
        cells.append(cell)
    columns = min(4, len(cells))
    cells += [np.full_like(cells[0], 255)] * (-len(cells) % columns)
    return np.concatenate([np.concatenate(cells[i : i + columns], 1) for i in range(0, len(cells), columns)])


# ---- a result over its recording ---------------------------------------------------------------------------------

_AHEAD = 2  # frames that are drawn and not yet written
_COLOURS = ((200, 190, 60), (70, 160, 240), (110, 200, 90), (220, 110, 200), (90, 210, 220), (230, 130, 80))
_SMALL_WIDTH = 480  # px, width of the small pictures


@dataclass(frozen=True)
class PictureRows:
    """Rows of a motion of which pictures are wanted.

    video: a video of all rows.
    stills: rows whose close-ups are wanted.
    small: rows whose recorded pictures are wanted, for the report's viewer.
    """

    video: bool = True
    stills: Sequence[int] = ()
    small: Sequence[int] = ()


@dataclass(frozen=True)
class OverlayRows:
    """Pictures that were drawn for a report, by row of the motion.

    stills: close-ups.
    small: the recorded picture of every view as JPEG, b"" where there is none.
    """

    stills: dict[int, Image] = field(default_factory=dict)
    small: dict[int, list[bytes]] = field(default_factory=dict)


@dataclass(frozen=True)
class Shown:
    """Person to draw over a recording.

    name: shown in the title bar; "" for a single person.
    motion: row i of all motions is the same frame.
    body: None where the motion has no poses: nothing of it is drawn.
    present: (T,) rows in which the person is there; None: all.
    """

    name: str
    motion: Motion
    body: Body | None
    present: NDArray[np.bool_] | None = None


def still_rows(motion: Motion, count: int = 4) -> list[int]:
    """Select rows of a motion to show.

    count: number of rows, evenly spread; the row with the worst fit is added.
    """
    rows = set(np.linspace(0, len(motion) - 1, min(count, len(motion))).astype(int).tolist())
    if np.isfinite(motion.cost).any():
        rows.add(int(np.nanargmax(motion.cost)))
    return sorted(rows)


def colour_of(number: int) -> tuple[int, int, int]:
    """Return the colour (BGR) of a person by their number."""
    return _COLOURS[number % len(_COLOURS)]


def write_overlay(
    path: str | Path,
    recording: Recording,
    source: FrameSource,
    people: Sequence[Shown],
    wanted: PictureRows,
    progress: ProgressCall = ignore,
) -> OverlayRows:
    """Draw people over their recording, several of them each in a colour of their own. The recorded pictures are read
    once.

    path: path of the video; not used without a video.
    source: gives the silhouettes; row i of the motions is frame i of the source, and recording.frames[i].
    wanted: rows that are drawn.
    Returns: stills and small pictures by row.
    """
    motion = people[0].motion
    numbers = recording.frames[: len(motion)]
    rows = range(len(numbers)) if wanted.video else sorted({*wanted.stills, *wanted.small})
    shown = OverlayRows()
    with ExitStack() as stack:
        images = stack.enter_context(open_images(recording))
        canvases = [Canvas(recording, images) for _ in range(_AHEAD + 1)]
        rate = motion.frame_rate if len(motion) > 1 else 25.0
        writer = stack.enter_context(writing_video(path, rate, canvases[0].size)) if wanted.video else None
        writing = stack.enter_context(ThreadPoolExecutor(1))
        written: deque[Future[None]] = deque()
        for done, row in enumerate(rows):
            progress("overlay", done, len(rows))
            if len(written) > _AHEAD:
                written.popleft().result()
            pictures = [view.read(numbers[row]) for view in images]
            if row in wanted.small:
                shown.small[row] = [b"" if p is None else jpeg(p, _SMALL_WIDTH) for p in pictures]
            if row in wanted.stills:
                what = _drawing(source, people, row, numbers[row])
                shown.stills[row] = draw_close_ups(pictures, recording, what)
            if writer is not None:  # the next frames are read and drawn while this one is being written
                picture = canvases[done % len(canvases)].draw(pictures, _drawing(source, people, row, numbers[row]))
                written.append(writing.submit(writer.write, picture))
        for one in written:
            one.result()
        progress("overlay", len(rows), len(rows))
    return shown


def _drawing(source: FrameSource, people: Sequence[Shown], row: int, number: int) -> Drawing:
    """Prepare the drawing of one row: masks, the bodies of the people whose pose is known, and a title that says how
    each fits.

    number: number of the frame.
    """
    drawn, alarm = list[DrawnBody](), False
    parts = [f"frame {number}", f"{people[0].motion.times[row]:.2f} s"]
    for k, p in enumerate(people):
        m = p.motion
        if p.present is not None and not p.present[row]:
            parts.append(f"{p.name} is not there")
            continue
        lost, extrapolated, iou = bool(m.lost[row]), bool(m.extrapolated[row]), 1 - float(m.cost[row])
        said = [p.name, f"IoU {iou:.2f}" if np.isfinite(iou) else "", "LOST" if lost else ""]
        said.append("extrapolated (no evidence)" if extrapolated else "")
        parts += filter(None, said)
        alarm |= lost or extrapolated
        if p.body is not None and m.poses is not None and np.isfinite(m.poses[row]).all():
            colour = ALARM if lost or extrapolated else BODY if len(people) == 1 else colour_of(k)
            drawn.append(DrawnBody(p.body, p.body.skin(m.poses[row], p.body.fine), m.joints[row], colour))
    return Drawing(source.frame(row).silhouettes, "   ".join(parts), tuple(drawn), alarm)
