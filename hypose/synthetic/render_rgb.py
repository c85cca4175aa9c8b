"""Render colour pictures of synthetic scenes: a dressed person in a textured room, with light, shadow, noise and lens.

The pictures are made to test a real background model as reality does: colours of clothes that are near those of the
room in places, a soft cast shadow, light that drifts, noise. All colours are approximately linear BGR in 0..255.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from hypose.body.skin_weights import vertex_normals
from hypose.cameras.camera import Camera
from hypose.compute.parts import covered
from hypose.compute.zbuffer import interpolate, rasterize
from hypose.geometry import Array, Image, unit
from hypose.synthetic.subjects import SyntheticSubject

Floats = NDArray[np.float32]

LIGHT = unit([0.42, -0.28, 0.86])
"""Direction towards the main light, world."""
SHADOW_DEPTH = 0.42
"""Share of the floor's brightness that comes from the main light, which a full shadow removes."""


@dataclass(frozen=True)
class Room:
    """Box-shaped room about the origin with procedural textures.

    half: (3,) m, half width, half depth, height.
    floor, walls: (3,) BGR colours.
    tiles: (3, 256, 256) float32, repeated noise of unit range: fine, middle, coarse.
    """

    half: Array
    floor: Array
    walls: Array
    tiles: NDArray[np.float32] = field(repr=False)


def make_room(rng: np.random.Generator, reach: float = 5.0) -> Room:
    """Make a room that holds every camera within `reach` m of its centre; colours and textures are random."""
    floor = np.array([70.0, 95.0, 120.0]) * rng.uniform(0.85, 1.25) + rng.normal(0, 8, 3)
    walls = np.array([150.0, 160.0, 165.0]) * rng.uniform(0.85, 1.15) + rng.normal(0, 8, 3)
    tiles = []
    for cell in (2, 8, 32):
        n = 256 // cell
        g = rng.normal(size=(n, n)).astype(np.float32)
        g = cv2.resize(np.tile(g, (3, 3)), (768, 768), interpolation=cv2.INTER_CUBIC)[256:512, 256:512]
        tiles.append(g)
    half = np.array([reach + rng.uniform(0.6, 1.4), reach + rng.uniform(0.6, 1.4), max(3.2, 0.62 * reach)])
    return Room(half, floor, walls, np.stack(tiles))


def _sample(tile: Floats, u: Array, v: Array, per_metre: float) -> Floats:
    """Sample a repeated texture.

    tile: (256, 256).
    u, v: coordinates of any shape, m.
    per_metre: texels per metre.
    Returns: values of the shape of u.
    """
    x = np.mod(u * per_metre, 255.0).astype(np.float32)
    y = np.mod(v * per_metre, 255.0).astype(np.float32)
    out = cv2.remap(tile, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.asarray(out, dtype=np.float32)


@dataclass(frozen=True)
class Backdrop:
    """Empty room as one camera sees it.

    image: (h, w, 3) float32 BGR.
    floor: (h, w) bool, pixels of the floor that nothing hides.
    depth: (h, w) m, depth of the occluders (inf elsewhere).
    """

    image: Floats
    floor: NDArray[np.bool_]
    depth: Floats


def render_room(room: Room, camera: Camera, occluder: tuple[Array, NDArray[np.int32]] | None = None) -> Backdrop:
    """Render the empty room through a camera with its lens distortion.

    occluder: mesh (vertices (V, 3) m, faces (F, 3)) that stands in it, or None.
    """
    w, h = camera.size
    uv = np.stack(np.meshgrid(np.arange(w), np.arange(h)), -1).astype(np.float64)
    origin, d = camera.rays(uv)
    lx, ly, lz = room.half
    top = max(lz, float(origin[2]) + 0.5)
    with np.errstate(divide="ignore", invalid="ignore"):
        tx = np.where(d[..., 0] > 0, (lx - origin[0]) / d[..., 0], (-lx - origin[0]) / d[..., 0])
        ty = np.where(d[..., 1] > 0, (ly - origin[1]) / d[..., 1], (-ly - origin[1]) / d[..., 1])
        tz = np.where(d[..., 2] > 0, (top - origin[2]) / d[..., 2], -origin[2] / d[..., 2])
    t = np.stack([np.nan_to_num(x, nan=np.inf) for x in (tx, ty, tz)], -1)
    side = t.argmin(-1)
    p = origin + d * t.min(-1)[..., None]
    fine, middle, coarse = room.tiles
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    floor = (side == 2) & (d[..., 2] < 0)
    # floor: planks 18 cm wide with seams, grain along them
    plank = np.floor(y / 0.18)
    grain = _sample(fine, x + 7.3 * plank, y * 6, 40)
    tone = _sample(coarse, plank * 3.1, np.floor(x / 1.7 + 0.37 * plank), 17)
    seam = (np.abs(np.mod(y, 0.18)) < 0.008) | (np.abs(np.mod(x + 0.63 * plank, 1.7)) < 0.01)
    light = 1 + 0.07 * grain + 0.10 * tone - 0.30 * seam
    light *= 1 + 0.12 * _sample(coarse, x, y, 20)
    image = room.floor * light[..., None]
    # walls: plaster, a darker base, panels and a few posters so that no view is flat
    along = np.where(side == 0, y, x)
    wall = 1 + 0.05 * _sample(middle, along, z, 60) + 0.10 * _sample(coarse, along, z, 16)
    wall *= np.where(np.mod(along, 1.2) < 0.02, 0.8, 1.0) * np.where(z < 0.12, 0.55, 1.0) * (0.8 + 0.1 * z)
    wall *= np.where(side == 0, 0.9, 1.0)
    cell = np.floor(along / 2.4)
    poster = (np.mod(along, 2.4) > 0.6) & (np.mod(along, 2.4) < 1.5) & (z > 1.1) & (z < 2.3)
    hue = np.stack(
        [0.55 + 0.45 * np.sin(2.1 * cell + k * 2.0 + 5.0 * (side == 0) + np.sign(x * y)) for k in range(3)],
        -1,
    )
    wall_image = np.where(poster[..., None], 170 * (0.35 + 0.5 * hue), room.walls) * wall[..., None]
    image = np.where(floor[..., None], image, wall_image)
    image = np.where(((side == 2) & ~floor)[..., None], room.walls * 1.15, image).astype(np.float32)
    depth = np.full((h, w), np.inf, np.float32)
    if occluder is not None:
        vertices, faces = occluder
        drawing = camera.project(vertices), camera.depths(vertices), faces
        depth, face = rasterize(*drawing, camera.size)
        drawn = face >= 0
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        shade = 0.55 + 0.45 * np.clip(unit(np.cross(b - a, c - a)) @ LIGHT, 0, 1)
        at = interpolate(face, *drawing, vertices)
        grain = (np.mod(at[:, :2] * [50, 250], 255)).astype(int)
        wood = 1 + 0.12 * middle[grain[:, 1], grain[:, 0]]
        image[drawn] = np.array([60.0, 85.0, 110.0]) * (shade[face[drawn]] * wood)[:, None]
        floor = floor & ~drawn
    return Backdrop(np.asarray(cv2.GaussianBlur(image, (0, 0), 0.6), dtype=np.float32), floor, depth)


@dataclass(frozen=True)
class Outfit:
    """Colours of a subject.

    color: (V, 3) BGR per vertex.
    weave: (V,) strength of the cloth's pattern.
    pattern: (3, 3) wave vectors of the pattern, 1/m.
    """

    color: Floats
    weave: Floats
    pattern: Array


def make_outfit(subject: SyntheticSubject, rng: np.random.Generator, hands_only: bool = False) -> Outfit:
    """Choose random colours for shirt, trousers, shoes, skin and hair of a subject.

    hands_only: only face and hands are bare, and no cloth has the colour of skin.
    """
    # no grey one: on the grey walls a background model would take it for a shadow
    palette = np.array([[140, 60, 40], [40, 40, 150], [60, 120, 50], [120, 45, 115], [45, 45, 50], [35, 120, 170]])
    i, k = rng.permutation(len(palette) - hands_only)[:2]  # the last one is the colour of skin
    shirt, trousers = palette[i] * rng.uniform(0.8, 1.15), palette[k] * rng.uniform(0.55, 0.9)
    skin = np.array([125.0, 155.0, 200.0]) * rng.uniform(0.5, 1.08)
    hair = np.array([30.0, 45.0, 65.0]) * rng.uniform(0.4, 1.9)
    shoes = np.array([45.0, 42.0, 40.0]) * rng.uniform(0.5, 2.5)
    part, v, j = subject.main_joint, subject.vertices, subject.joints
    color = np.tile(skin, (len(v), 1))
    weave = np.zeros(len(v))
    short = bool(rng.random() < 0.5) and not hands_only
    sleeve = np.isin(part, (6, 10))
    if short:  # half of the upper arm is covered
        for a in (6, 10):
            along = (j[a + 1] - j[a]) / np.linalg.norm(j[a + 1] - j[a]) ** 2
            sleeve &= (part != a) | ((v - j[a]) @ along < 0.6)
    else:
        sleeve |= np.isin(part, (7, 11))
    waist = 0.25 * (j[1, 2] - j[0, 2])
    top = np.isin(part, (1, 2, 5, 9)) | sleeve | ((part == 0) & (v[:, 2] > waist))
    legs = np.isin(part, (13, 14, 16, 17)) | ((part == 0) & ~top)
    feet = np.isin(part, (15, 18))
    for where, tint in ((top, shirt), (legs, trousers), (feet, shoes)):
        color[where] = tint
        weave[where] = 1.0
    head = part == 4
    if head.any():
        low, high = v[head, 2].min(), v[head, 2].max()
        middle = (v[head, 1].min() + v[head, 1].max()) / 2
        # hair on top and behind; the face looks to -y
        hairy = head & (
            (v[:, 2] > low + 0.78 * (high - low)) | ((v[:, 1] > middle) & (v[:, 2] > low + 0.3 * (high - low)))
        )
        color[hairy] = hair
    pattern = unit(rng.normal(size=(3, 3))) * (2 * np.pi / np.array([[0.05], [0.11], [0.23]]))
    return Outfit(color.astype(np.float32), weave.astype(np.float32), pattern)


@dataclass(frozen=True)
class Sensor:
    """Properties of the simulated colour camera.

    noise_sd: grey levels of Gaussian noise per channel.
    drift: relative sd of the slow change of the light.
    samples: samples per pixel and axis for the body's outline.
    """

    noise_sd: float = 2.5
    drift: float = 0.012
    samples: int = 2


def light_at(time: float, drift: float, phase: Array) -> Array:
    """Compute the brightness factor (3,) of each colour channel at a time (s); light and colour drift slowly, with
    periods of 20 to 90 s.

    drift: relative size.
    phase: (5,) phases of the waves, rad.
    """
    common = np.sin(2 * np.pi * time / 37.0 + phase[0]) + 0.6 * np.sin(2 * np.pi * time / 90.0 + phase[1])
    color = 0.35 * np.sin(2 * np.pi * time / 23.0 + phase[2:5])
    return 1 + drift * (common + color)


def render_person(
    picture: Floats,
    backdrop: Backdrop,
    camera: Camera,
    subject: SyntheticSubject,
    outfit: Outfit,
    vertices: Array,
    samples: int,
) -> None:
    """Draw a subject with its cast shadow on the floor into a picture, in place.

    picture: (h, w, 3) float32 BGR.
    backdrop: the empty room, whose occluders hide the subject.
    camera: with lens distortion.
    subject, outfit: the person, and the colours of the clothes.
    vertices: (V, 3) m, world.
    samples: samples per pixel and axis.
    """
    cast_shadow(picture, backdrop, camera, subject, vertices)
    uv, z = camera.project(vertices), camera.depths(vertices)
    w, h = camera.size
    good = np.isfinite(uv).all(1)
    if not good.any():
        return
    x0, y0 = np.maximum(np.floor(uv[good].min(0)).astype(int) - 2, 0)
    x1, y1 = np.minimum(np.ceil(uv[good].max(0)).astype(int) + 3, [w, h])
    if x0 >= x1 or y0 >= y1:
        return
    s = samples
    fine = (uv - [x0, y0] + 0.5) * s - 0.5
    depth, face = rasterize(fine, z, subject.faces, ((x1 - x0) * s, (y1 - y0) * s))
    hidden = backdrop.depth[y0:y1, x0:x1]
    if np.isfinite(hidden).any():
        face = np.where(depth < np.repeat(np.repeat(hidden, s, 0), s, 1), face, np.int32(-1))
    n = vertex_normals(vertices, subject.faces)
    fold = np.sin(subject.vertices @ outfit.pattern.T).sum(1)
    color = outfit.color * (1 + 0.08 * outfit.weave * fold)[:, None]
    values = np.column_stack([color, n @ LIGHT, n[:, 2]])
    part, drawn = picture[y0:y1, x0:x1], face >= 0
    ambient, direct, sky = (np.float32(x) for x in _LIT)
    at = interpolate(face, fine, z, subject.faces, values)
    lit = ambient + direct * np.maximum(at[:, 3:4], 0) + sky * at[:, 4:]
    colour = np.zeros((*face.shape, 3), np.float32)
    colour[drawn] = lit * at[:, :3]
    blocks = y1 - y0, s, x1 - x0, s
    part *= 1 - drawn.reshape(blocks).mean((1, 3), dtype=np.float32)[..., None]
    part += colour.reshape(*blocks, 3).mean((1, 3))


# Shares of the light: ambient, from the main light, from above.
_LIT = (0.42, 0.62, 0.10)


def cast_shadow(
    picture: Floats, backdrop: Backdrop, camera: Camera, subject: SyntheticSubject, vertices: Array
) -> None:
    """Darken the floor of a picture in place where the body hides the main light; the edge is as soft as that of a
    lamp.

    picture: (h, w, 3) float32 BGR.
    backdrop: whose visible floor is darkened.
    camera: camera of the picture.
    subject, vertices: the body, and its vertices (V, 3) m, world.
    """
    mask = shadow_mask(camera, subject.faces, vertices)
    x, y, w, h = cv2.boundingRect(mask)
    if w == 0:
        return
    rows, columns = slice(max(y - 5, 0), y + h + 5), slice(max(x - 5, 0), x + w + 5)
    soft = cv2.GaussianBlur(mask[rows, columns].astype(np.float32), (0, 0), 1.5)
    soft = np.where(backdrop.floor[rows, columns], soft, 0).astype(np.float32)
    picture[rows, columns] *= (1 - np.float32(SHADOW_DEPTH) * soft)[..., None]


def shadow_mask(camera: Camera, faces: NDArray[np.int32], vertices: Array) -> NDArray[np.uint8]:
    """Compute the mask (h, w) 0/1 of the floor that a body hides from the main light, as the camera sees it without the
    body.

    faces, vertices: (F, 3) and (V, 3) m, world.
    """
    ground = vertices - LIGHT * (vertices[:, 2:] / LIGHT[2])
    ground[:, 2] = 0.0
    return covered(camera.project(ground), camera.depths(ground), faces, camera.size[::-1])


def develop(picture: Floats, gain: Array, noise: NDArray[np.int16], rng: np.random.Generator) -> Image:
    """Convert a picture (h, w, 3) to 8 bit with the light's gain (3,) and sensor noise.

    noise: (h + 64, w + 64, 3) noise picture (`noise_bank`), of which each frame uses another window, mirrored at
        random.
    Why: for a background model this is as good as new noise, and ten times faster.
    """
    h, w = picture.shape[:2]
    y, x = rng.integers(0, 65, 2)
    grain = noise[y : y + h, x : x + w]
    if rng.random() < 0.5:
        grain = grain[::-1]
    if rng.random() < 0.5:
        grain = grain[:, ::-1]
    seen = picture * np.asarray(gain, dtype=np.float32)
    seen += grain
    seen += np.float32(0.5)  # rounds
    return np.clip(seen, 0, 255, out=seen).astype(np.uint8)


def noise_bank(size: tuple[int, int], sd: float, rng: np.random.Generator) -> NDArray[np.int16]:
    """Draw a picture of Gaussian noise that is larger than the frames, from which `develop` takes a window for each
    frame.

    size: (w, h) size of the pictures, px.
    sd: standard deviation, grey levels.
    rng: random numbers.
    Returns: (h + 64, w + 64, 3) whole grey levels.
    """
    w, h = size
    return np.round(rng.normal(0, sd, (h + 64, w + 64, 3))).astype(np.int16)
