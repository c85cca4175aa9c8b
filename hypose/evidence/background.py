"""Build background models: the colour of each pixel when the person is not there.

They come from a clip of the empty room, from photos, or from the recording itself (the person moves, the room does
not). Images are BGR uint8 at working size, undistorted; all arrays are (h, w[, 3]).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hypose.compute.picture_to_mask import order_statistic
from hypose.errors import InputError
from hypose.geometry import Image

Images = NDArray[np.uint8] | Sequence[NDArray[np.uint8]]

_PLATE_SD = 5.0  # grey levels: a photo says nothing about noise, and light differs a little between photo and video
_SD_FLOOR = 1.0  # 8-bit video cannot be quieter
_AGREE = 40  # grey levels: photo and video within this show the same thing (for the gain)
_BLACK, _AGREEING_SHARE = 10, 0.05  # grey levels too dark to measure a gain; least share of the picture that must agree
_STATIC = 12  # grey levels: a pixel within this of its median has not changed
_OTHER_THING = 20  # grey levels: photo and median beyond this show different things
_STATIC_SHARE = 0.6  # least share of the frames in which a thing must be present to be part of the room
_MIN_FREE = 4  # frames in which a pixel must be free of the person, and the share of all frames
_MIN_FREE_SHARE = 0.12


@dataclass(frozen=True)
class BackgroundModel:
    """Gaussian model of each pixel and channel of the empty room.

    mean, sd: (h, w, 3) float32 grey levels (BGR, 0-255).
    valid: (h, w) False where the room was never seen.
    note: a sentence for the user about doubtful areas, "" when there are none.
    """

    mean: NDArray[np.float32]
    sd: NDArray[np.float32]
    valid: NDArray[np.bool_]
    note: str = ""


def from_frames(frames: Images, what: str = "background clip") -> BackgroundModel:
    """Build the model from a clip of the empty room (N, h, w, 3) uint8: median and robust sd (1.4826 MAD) per pixel.

    what: name of the clip in error messages.
    Raises: InputError where there is no image, or the sizes differ.
    """
    stack = _stack(frames, what)
    median, sd, _ = _masked_median(stack, None)
    return BackgroundModel(median, sd, np.ones(stack.shape[1:3], dtype=np.bool_))


def from_plates(images: Images) -> BackgroundModel:
    """Build the model from one or more photos of the empty room (N, h, w, 3) uint8, with an sd that allows for other
    light.
    """
    model = from_frames(images, "background photos")
    return replace(model, sd=np.maximum(model.sd, np.float32(_PLATE_SD)))


def from_recording(
    frames: Images, covered: NDArray[np.generic] | None = None, plate: BackgroundModel | None = None
) -> BackgroundModel:
    """Build the model from a recording in which the person moves.

    frames: (N, h, w, 3) uint8, spread over the recording.
    covered: (N, h, w) not 0 where the person is or may be (thick skeleton of key points, or silhouette of a tracked
        model). Then a pixel is the median over the frames in which it is free, and that of the photo where it never is
        free.
    plate: model of photos. Without `covered` it is the result, except where the recording nearly always shows something
        else there (a box moved after the photo, a person in the photo): there the temporal median is used. A static
        thing whose outline moves is no part of the room, but a part of the person that stands still.
    Returns: the model; without `plate` and `covered` the temporal median, whose `note` says what to mistrust.
    Raises: InputError where the sizes differ.
    """
    stack = _stack(frames, "recording")
    shape = stack.shape[1:3]
    if plate is not None and plate.valid.shape != shape:
        raise InputError(
            f"The background picture is {plate.valid.shape[::-1]} px at working size, the recording "
            f"{shape[::-1]} px; give "
            "a picture of the same camera in the same orientation."
        )
    if covered is not None:
        if covered.shape != stack.shape[:3]:
            raise InputError(f"{len(stack)} frames need masks of shape {stack.shape[:3]}, got {covered.shape}.")
        return _from_free_frames(stack, np.asarray(covered) != 0, plate)
    median, sd, _ = _masked_median(stack, None)
    if plate is not None:
        return _cure_ghosts(stack, median, sd, match_gain(plate, median))
    share = (_deviation(stack, median) < _STATIC).mean(0)
    never, doubtful = float((share == 1).mean()), float((share < _STATIC_SHARE).mean())
    changing = f"; {100 * doubtful:.1f} % changes in most frames and is uncertain" if doubtful > 0.002 else ""
    note = (
        f"The background is the median of the recording itself: {100 * never:.0f} % of the picture never changes, and "
        f"a person who stands still there becomes a part of the background{changing}. A clip or photo of the empty "
        "room cures both."
    )
    return BackgroundModel(median, sd, np.ones(shape, dtype=np.bool_), note)


def match_gain(plate: BackgroundModel, reference: NDArray[np.floating]) -> BackgroundModel:
    """Scale each channel of a model to the brightness of a reference picture (h, w, 3).

    plate: the model. Returns: the model with a scaled mean; its sd is unchanged.
    The scale is the median ratio over the pixels where both roughly agree; 1 where hardly any do.
    """
    gain = gain_between(plate.mean, reference)
    return replace(plate, mean=np.clip(plate.mean * gain, 0, 255).astype(np.float32))


def gain_between(mean: NDArray[np.float32], reference: NDArray[np.floating]) -> NDArray[np.float32]:
    """Compute the factors (3,) that scale the channels of an image `mean` (h, w, 3) to the brightness of a reference
    image.

    The factor is the median ratio over the pixels where both images roughly agree; 1 where hardly any pixels do.
    """
    # ten times as fast as numpy along an axis of three
    apart = np.maximum.reduce([np.abs(mean[..., c] - reference[..., c]) for c in range(3)])
    agree = (apart < _AGREE) & (np.minimum.reduce([mean[..., c] for c in range(3)]) > _BLACK)
    if agree.mean() < _AGREEING_SHARE:
        return np.ones(3, np.float32)
    return np.median(reference[agree] / mean[agree], axis=0).astype(np.float32)


def _stack(images: Images, what: str) -> Image:
    """Check that images have one size and three channels, and stack them (N, h, w, 3).

    what: their name in the error message.
    Raises: InputError where there is none, or the sizes differ.
    """
    if len(images) == 0:
        raise InputError(f"The {what} holds no readable image; a background model needs at least one.")
    sizes = {np.shape(i) for i in images}
    if len(sizes) > 1 or np.ndim(images[0]) != 3 or np.shape(images[0])[2] != 3:
        raise InputError(f"The {what} must hold colour images of one size, got the shapes {sorted(sizes)}.")
    return np.asarray(images, dtype=np.uint8)


def _masked_median(
    stack: Image, free: NDArray[np.bool_] | None
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
    """Compute median and robust sd (h, w, 3) of the stack (N, h, w, 3) over the free frames (N, h, w), and their
    number.
    """
    n, h, w, _ = stack.shape
    count = np.full((h, w), n) if free is None else free.sum(0)
    middle = np.maximum(count - 1, 0).ravel()
    low, high = middle // 2, (middle + 1) // 2
    flat = stack.reshape(n, h * w, 3)
    hidden = None if free is None else ~free.reshape(n, h * w)

    def centre(values: Image) -> NDArray[np.float32]:
        lower = order_statistic(values, hidden, low)
        upper = lower if (low == high).all() else order_statistic(values, hidden, high)
        return np.float32(0.5) * (lower.astype(np.float32) + upper)

    median = centre(flat)
    reference = np.rint(median).astype(np.uint8)
    deviation = np.stack([np.asarray(cv2.absdiff(f, reference), dtype=np.uint8) for f in flat])
    sd = np.maximum(np.float32(1.4826) * centre(deviation), np.float32(_SD_FLOOR))
    return median.reshape(h, w, 3), sd.reshape(h, w, 3), count


def _from_free_frames(stack: Image, covered: NDArray[np.bool_], plate: BackgroundModel | None) -> BackgroundModel:
    """Build the model from the frames in which each pixel is free of the person.

    stack: (N, h, w, 3) frames.
    covered: (N, h, w) true where the person is or may be.
    plate: model of photos, or None.
    Returns: the model; pixels that are hardly ever free come from the photos, without photos they are not valid.
    """
    median, sd, count = _masked_median(stack, ~covered)
    free = count >= min(max(_MIN_FREE, _MIN_FREE_SHARE * len(stack)), len(stack))
    if plate is not None:
        plate = match_gain(plate, np.where(free[..., None], median, plate.mean))
        pick = free[..., None]
        return BackgroundModel(
            np.where(pick, median, plate.mean), np.where(pick, sd, plate.sd), free | plate.valid, plate.note
        )
    if free.all():
        return BackgroundModel(median, sd, free)
    whole, _, _ = _masked_median(stack, None)
    note = (
        f"{100 * (1 - free.mean()):.1f} % of the picture is covered by the person in every frame, so the room "
        f"behind is "
        "unknown there; a photo or clip of the empty room would show it."
    )
    wide = np.maximum(sd, np.float32(_PLATE_SD))
    return BackgroundModel(np.where(free[..., None], median, whole), np.where(free[..., None], sd, wide), free, note)


def _cure_ghosts(
    stack: Image, median: NDArray[np.float32], sd: NDArray[np.float32], plate: BackgroundModel
) -> BackgroundModel:
    """Replace a model by the recording's median where a static thing contradicts it (see from_recording).

    stack: (N, h, w, 3) frames.
    median, sd: (h, w, 3) median and standard deviation of the frames.
    plate: model of photos, in the brightness of the median.
    """
    stable = (_deviation(stack, median) < _STATIC).mean(0) > _STATIC_SHARE
    ghost = stable & (np.abs(median - plate.mean).max(2) > _OTHER_THING)
    low = np.ceil(np.clip(plate.mean - _OTHER_THING, 0, 255)).astype(np.uint8)
    high = np.floor(np.clip(plate.mean + _OTHER_THING, 0, 255)).astype(np.uint8)
    unlike = np.stack([np.equal(cv2.inRange(f, low, high), 0) for f in stack])
    ghost &= ~_parts_of_the_person(ghost, unlike.mean(0))
    still = _person_who_never_moves(ghost, unlike)
    note = ""
    if still.any():
        ghost &= ~still
        note = (
            "Hardly anything moves, so the largest thing that is not in the photo is taken as the person; if that is "
            "wrong, take a photo of the room as it was during the recording."
        )
    pick = ghost[..., None]
    mean, spread = np.where(pick, median, plate.mean), np.where(pick, sd, plate.sd)
    return BackgroundModel(mean, spread, plate.valid, note or plate.note)


def _person_who_never_moves(ghost: NDArray[np.bool_], unlike: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Find a person who does not move in the whole recording: the largest static region unlike the photo.

    ghost: (h, w) what would become part of the room.
    unlike: (N, h, w) pixels that differ from the photo, per frame.
    Returns: (h, w); empty where something else of comparable size differs from the photo too.
    """
    label, area = _regions(ghost)
    if not len(area):
        return np.zeros_like(ghost)
    solid = np.ones((3, 3), np.uint8)
    rest = [cv2.morphologyEx((u & ~ghost).astype(np.uint8), cv2.MORPH_OPEN, solid) for u in unlike]
    besides = float(np.median([max(_regions(r)[1], default=0) for r in rest]))
    return label == int(area.argmax()) + 1 if besides < 0.3 * area.max() else np.zeros_like(ghost)


def _regions(mask: ArrayLike) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Label the connected regions of a mask (h, w): labels (h, w) from 1, areas."""
    _, label, stats, _ = cv2.connectedComponentsWithStats(np.asarray(mask, dtype=np.uint8), connectivity=8)
    return np.asarray(label, dtype=np.int32), np.asarray(stats[1:, cv2.CC_STAT_AREA], dtype=np.int64)


def _parts_of_the_person(ghost: NDArray[np.bool_], differs: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Find the static regions that contradict the photo but are parts of the person: their surroundings come and go.

    ghost: (h, w) static and unlike the photo.
    differs: (h, w) share of the frames that differ from the photo.
    Why: the torso of a person who moves the limbs is static too, but pixels along its outline alternate between person
        and room.
    """
    count, label = cv2.connectedComponents(ghost.astype(np.uint8), connectivity=4)
    moving = ((differs > 0.1) & (differs < 0.9) & ~ghost).astype(np.uint8)
    out = np.zeros_like(ghost)
    for k in range(1, count):
        part = (label == k).astype(np.uint8)
        rim = (cv2.dilate(part, np.ones((5, 5), np.uint8)) > part) & ~ghost
        if rim.any() and moving[rim].mean() > 0.5:
            out |= part > 0
    return out


def _deviation(stack: Image, median: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Compute the largest channel difference (N, h, w) from the median picture.

    stack: (N, h, w, 3) frames.
    median: (h, w, 3) grey levels.
    """
    reference = np.rint(median).astype(np.uint8)
    apart = [cv2.absdiff(picture, reference).reshape(-1, 3) for picture in stack]
    return np.reshape([cv2.reduce(a, 1, cv2.REDUCE_MAX) for a in apart], stack.shape[:3]).astype(np.uint8, copy=False)
