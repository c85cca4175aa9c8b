"""Draw results on the recorded images of all views: body, skeleton and mask, arranged in tiles.

Points are projected with the lens distortion of the calibration and the view's image_shift onto the recorded images; so
a body that is off in the picture is off in the result.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.body.body import Body, Mesh
from hypose.cameras.camera import Camera
from hypose.compute.parts import covered, projected
from hypose.errors import InputError, visible
from hypose.evidence.frame import Silhouettes
from hypose.geometry import Array, Image
from hypose.io.recordings.object_masks import ObjectMasks
from hypose.io.recordings.recording import Recording, ViewSettings
from hypose.io.recordings.recording_views import open_pictures
from hypose.io.videos.video import VideoReader

# BGR; also different for people with red-green colour blindness
_LEFT, _RIGHT, MIDDLE = (40, 130, 240), (225, 140, 40), (235, 235, 235)
BODY, _MASK, ALARM = (200, 190, 60), (190, 90, 230), (40, 40, 230)
MAX_TILE, MAX_WIDTH = 960, 1920
_BAR, _GREY = 26, 24
_SMALL = 640 * 480


@dataclass(frozen=True)
class Tile:
    """Place of a view in the picture.

    column, row: cell of the view.
    size: (width, height) at which it is shown, px.
    """

    column: int
    row: int
    size: tuple[int, int]


@dataclass(frozen=True)
class _TileLayout:
    """Tiles of all views under a title bar.

    cell: (width, height) of a cell, px.
    size: (width, height) of the whole picture, px.
    """

    tiles: tuple[Tile, ...]
    cell: tuple[int, int]
    size: tuple[int, int]

    def origin(self, tile: Tile) -> tuple[int, int]:
        """Return the top left corner (x, y) px of a tile, centred in its cell."""
        (w, h), (tw, th) = self.cell, tile.size
        return tile.column * w + (w - tw) // 2, _BAR + tile.row * h + (h - th) // 2


def tile_layout(sizes: Sequence[tuple[int, int]]) -> _TileLayout:
    """Arrange views of the given sizes (width, height) px in tiles, each at most 960 px wide and all
    together 1920 px.
    """
    n = len(sizes)
    columns = math.ceil(math.sqrt(n)) if n != 3 else 3
    rows = math.ceil(n / columns)
    width = min(MAX_TILE, MAX_WIDTH // columns)
    shown = []
    for w, h in sizes:
        scale = min(1.0, width / w, MAX_TILE / h)
        shown.append((max(2, round(w * scale)), max(2, round(h * scale))))
    cell = (max(w for w, _ in shown), max(h for _, h in shown))
    tiles = tuple(Tile(i % columns, i // columns, s) for i, s in enumerate(shown))
    whole = (columns * cell[0] // 2 * 2, (_BAR + rows * cell[1]) // 2 * 2)
    return _TileLayout(tiles, cell, whole)


class ViewImages:
    """Recorded pictures of one view by frame number, read forwards; grey pictures of the masks where there are only
    masks.
    """

    def __init__(self, view: ViewSettings, camera: Camera) -> None:
        self.view, self.camera = view, camera
        # with small pictures several threads are no faster, and slow down the one that writes the video
        threads = 1 if math.prod(camera.size) <= _SMALL else None
        self._reader: VideoReader | ObjectMasks | None = open_pictures(view, threads) if view.has_pictures else None
        self.size: tuple[int, int] = self._reader.size if self._reader is not None else camera.size
        self._memory: Image | None = None

    def read(self, index: int, out: Image | None = None) -> Image | None:
        """Read frame `index`; None where the view ends before it or the frame is damaged.

        out: memory for the picture, used where it has the right size. The returned picture is valid until the next one
            is read.
        """
        if self._reader is None or index >= self._reader.n_frames:
            return None
        try:
            if out is None or not isinstance(self._reader, VideoReader):
                image = self._reader.read(index)
            elif out.shape[1::-1] == self.size:
                image = self._reader.read(index, out)
            else:
                image = self._memory = self._reader.read(index, self._memory)
        except InputError:  # tracking has left out this frame of the view and reported it
            return None
        return image if self.view.source is not None else (image // 3 + 40).astype(np.uint8)

    def close(self) -> None:
        """Release the file."""
        if self._reader is not None:
            self._reader.close()


def open_images(recording: Recording) -> list[ViewImages]:
    """Open the pictures of all views."""
    return [ViewImages(v, c) for v, c in zip(recording.views, recording.rig, strict=True)]


def as_shown(view: ViewSettings, camera: Camera, size: tuple[int, int]) -> Camera:
    """Return the camera, with its lens, for the pixels of the recorded image shown at `size`."""
    shown = camera.scaled(size)
    shown.K[:2, 2] -= np.asarray(view.image_shift) * size / camera.size
    return shown


def image_points(view: ViewSettings, camera: Camera, points_world: Array, size: tuple[int, int]) -> Array:
    """Project points (..., 3) m to pixels (..., 2) of the recorded image shown at `size`; NaN behind the camera."""
    return as_shown(view, camera, size).project(points_world)


def mask_outline(
    view: ViewSettings, camera: Camera, working: Camera, mask: NDArray[np.uint8], size: tuple[int, int]
) -> list[NDArray[np.int32]]:
    """Convert the outlines of a mask to polygons in the recorded image shown at `size`.

    working: undistorted camera of the mask's size.
    mask: (h, w).
    """
    return _outline(as_shown(view, camera, size), working, mask)


def _outline(camera: Camera, working: Camera, mask: NDArray[np.uint8]) -> list[NDArray[np.int32]]:
    """Convert the outlines of a mask to polygons in the pixels of a camera at the same place."""
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


def draw_mask(image: Image, outlines: Sequence[NDArray[np.int32]]) -> None:
    """Draw the mask's edge as a thin line."""
    cv2.polylines(image, list(outlines), True, _MASK, 1, cv2.LINE_AA, _SHIFT)


def draw_body(image: Image, camera: Camera, vertices: Array, mesh: Mesh, colour: tuple[int, int, int] = BODY) -> None:
    """Draw the silhouette of a mesh as a tint with a bright edge.

    camera: its pixels are those of the image.
    vertices: (V, 3) m, world.
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
    """Encode a picture as JPEG, at most `width` px wide."""
    h, w = image.shape[:2]
    if w > width:
        image = np.asarray(
            cv2.resize(image, (width, max(1, round(h * width / w))), interpolation=cv2.INTER_AREA), np.uint8
        )
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def bones(body: Body) -> Iterator[tuple[int, int, tuple[int, int, int]]]:
    """Yield (parent, child, BGR colour) of every bone."""
    for j, p in enumerate(body.skeleton.parents.tolist()):
        if p >= 0:
            name = body.skeleton.joint_names[j]
            yield p, j, _LEFT if name.startswith("left") else _RIGHT if name.startswith("right") else MIDDLE


def draw_skeleton(image: Image, camera: Camera, body: Body, joints: Array) -> None:
    """Draw bones between joint centres (J, 3) m, world: the left side orange, the right side blue. The camera's pixels
    are those of the image.
    """
    uv = camera.project(joints)
    width = 2 if max(camera.size) > 480 else 1
    seen = np.isfinite(uv.sum(1))
    uv[~seen] = 0
    at = _fixed(uv)[:, 0].tolist()
    for a, b, colour in bones(body):
        if seen[a] and seen[b]:
            cv2.line(image, at[a], at[b], (20, 20, 20), width + 2, cv2.LINE_AA, _SHIFT)
            cv2.line(image, at[a], at[b], colour, width, cv2.LINE_AA, _SHIFT)


def put_text(image: Image, text: str, x: int, y: int, colour: tuple[int, int, int] = (255, 255, 255)) -> None:
    """Write a text with a dark outline; x, y: left end of the base line."""
    font, size, text = cv2.FONT_HERSHEY_SIMPLEX, 0.5, visible(text)  # invalid UTF-8 would kill OpenCV
    for dx, dy in ((-1, 0), (1, 0), (0, -1), (0, 1)):  # a thicker stroke would be wider in OpenCV 5, hence no rim
        cv2.putText(image, text, (x + dx, y + dy), font, size, (0, 0, 0), 1, cv2.LINE_AA)
    cv2.putText(image, text, (x, y), font, size, colour, 1, cv2.LINE_AA)


@dataclass(frozen=True)
class Drawing:
    """Content of one frame to draw.

    vertices, joints: (V, 3) and (J, 3) m, world, of the body.
    silhouettes: of the frame, if any.
    title: text of the title bar.
    alarm: the title bar and the body are red.
    others: further bodies with vertices and colour (BGR).
    """

    vertices: Array | None
    joints: Array | None
    silhouettes: Silhouettes | None
    title: str
    alarm: bool = False
    others: tuple[tuple[Body, Array, tuple[int, int, int]], ...] = ()


def draw_view(
    image: Image | None,
    view: ViewSettings,
    camera: Camera,
    index: int,
    size: tuple[int, int],
    body: Body | None,
    what: Drawing,
) -> Image:
    """Draw one view at `size` with body, mask and skeleton."""
    out = np.empty((size[1], size[0], 3), np.uint8)
    _draw_view(out, image, as_shown(view, camera, size), index, body, what)
    return out


def _draw_view(out: Image, image: Image | None, camera: Camera, index: int, body: Body | None, what: Drawing) -> None:
    """Draw one view into `out`, which may be `image` itself; the camera's pixels are those of `out`."""
    if image is None:
        out[:] = 40
        put_text(out, "no image", 8, len(out) // 2)
    elif image.shape != out.shape:
        how = cv2.INTER_AREA if out.shape[1] < image.shape[1] else cv2.INTER_LINEAR
        cv2.resize(image, camera.size, out, interpolation=how)
    elif image is not out:
        out[:] = image
    if body is not None and what.vertices is not None:
        draw_body(out, camera, what.vertices, body.fine, ALARM if what.alarm else BODY)
    for other, vertices, colour in what.others:
        draw_body(out, camera, vertices, other.fine, colour)
    s = what.silhouettes
    if s is not None:
        draw_mask(out, _outline(camera, s.rig[index], s.masks[index]))
    if body is not None and what.joints is not None:
        draw_skeleton(out, camera, body, what.joints)


def _write_labels(shown: Image, view: ViewSettings, index: int, what: Drawing) -> None:
    put_text(shown, view.name, 6, 18)
    s = what.silhouettes
    if s is not None and not s.usable[index]:
        reason = (s.reasons[index] or "no reason given").split(": ", 1)[-1].split(" (")[0]
        put_text(shown, f"left out: {reason}"[:70], 6, shown.shape[0] - 8, (120, 140, 255))


class Canvas:
    """Memory for a picture of all views under a title bar; a picture is valid until the next one is drawn."""

    def __init__(self, recording: Recording, plan: _TileLayout) -> None:
        views = list(zip(recording.views, recording.rig, plan.tiles, strict=True))
        self._views, self._size = recording.views, plan.size
        self._cameras = [as_shown(view, camera, tile.size) for view, camera, tile in views]
        (w, h), columns = plan.cell, max(tile.column for tile in plan.tiles) + 1
        # the size of the picture may be a pixel less than the sum of the tiles
        self._whole = np.full((_BAR + (plan.tiles[-1].row + 1) * h, columns * w, 3), _GREY, np.uint8)
        self._tiles = []
        for tile in plan.tiles:
            x, y = plan.origin(tile)
            self._tiles.append(self._whole[y : y + tile.size[1], x : x + tile.size[0]])

    def read(self, images: Sequence[ViewImages], index: int) -> list[Image | None]:
        """Read frame `index` of every view, directly into the tiles where the size fits."""
        return [view.read(index, tile) for view, tile in zip(images, self._tiles, strict=True)]

    def draw(self, images: Sequence[Image | None], body: Body | None, what: Drawing) -> Image:
        """Draw all views of one frame and return the picture."""
        for c, (image, tile, camera) in enumerate(zip(images, self._tiles, self._cameras, strict=True)):
            _draw_view(tile, image, camera, c, body, what)
            _write_labels(tile, self._views[c], c, what)
        self._whole[:_BAR] = (30, 30, 150) if what.alarm else _GREY
        put_text(self._whole, what.title, 8, 18)
        return self._whole[: self._size[1], : self._size[0]]


def draw_all(
    images: Sequence[Image | None], recording: Recording, plan: _TileLayout, body: Body | None, what: Drawing
) -> Image:
    """Draw all views of one frame in tiles under a title bar."""
    return Canvas(recording, plan).draw(images, body, what)


def draw_close_ups(
    images: Sequence[Image | None], recording: Recording, body: Body, what: Drawing, side: int = 300, columns: int = 4
) -> Image:
    """Draw every view of one frame, cut to a square of `side` px around the body, side by side."""
    cells = []
    for c, (image, view, camera) in enumerate(zip(images, recording.views, recording.rig, strict=True)):
        cell = np.full((side, side, 3), 40, np.uint8)
        if image is not None and what.vertices is not None:
            full = (image.shape[1], image.shape[0])
            uv = image_points(view, camera, what.vertices, full)
            uv = uv[np.isfinite(uv).all(1)]
            low, high = (uv.min(0), uv.max(0)) if len(uv) else (np.zeros(2), np.array(full, dtype=float))
            reach = 1.2 * float((high - low).max())
            scale = float(np.clip(side / max(reach, 1.0), 0.1, 2.5))
            size = (max(2, round(full[0] * scale)), max(2, round(full[1] * scale)))
            shown = draw_view(image, view, camera, c, size, body, what)
            x, y = np.rint(scale * 0.5 * (low + high) - side / 2).astype(int).tolist()
            x0, y0, x1, y1 = max(x, 0), max(y, 0), min(x + side, size[0]), min(y + side, size[1])
            if x0 < x1 and y0 < y1:
                cell[y0 - y : y1 - y, x0 - x : x1 - x] = shown[y0:y1, x0:x1]
        _write_labels(cell, view, c, what)
        cells.append(cell)
    columns = min(columns, len(cells))
    cells += [np.full_like(cells[0], 255)] * (-len(cells) % columns)
    return np.concatenate([np.concatenate(cells[i : i + columns], 1) for i in range(0, len(cells), columns)])
