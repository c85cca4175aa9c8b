"""numba: connected pieces of a picture, and which of them are touched (pieces.py). Pictures have a rim of zeros, one
pixel wide, so that nothing has to ask where they end."""

from __future__ import annotations

from hypose.compute.compiled import kernel


@kernel
def thin_both(bits, others, step, out):
    """1 in out (h + 2, w + 2), within its rim, where every step-th pixel is set in both of two packed masks (H, B)."""
    for r in range(out.shape[0] - 2):
        y, x = r * step, 0
        for c in range(1, out.shape[1] - 1):
            out[r + 1, c] = ((bits[y, x >> 3] & others[y, x >> 3]) >> (x & 7)) & 1
            x += step


@kernel
def areas_of_pieces(picture, at, places, found):
    """Pixels of the pieces of a picture (h + 2, w + 2), corners connect, in which one of at (N, 2), columns and rows
    without the rim, lies, and of the largest of the others, into found (2,). The picture is zero afterwards; places
    (h w,) is scratch."""
    own, largest, width = 0, 0, picture.shape[1]
    flat = picture.reshape(picture.size)
    for i in range(at.shape[0]):
        own += _taken(flat, width, (at[i, 1] + 1) * width + at[i, 0] + 1, places)
    for i in range(flat.size):
        if flat[i]:
            largest = max(largest, _taken(flat, width, i, places))
    found[0], found[1] = own, largest


@kernel
def _taken(flat, width, first, places):
    """Pixels of the piece with pixel `first`, which is taken out of the picture; 0 where there is none."""
    if not flat[first]:
        return 0
    flat[first] = 0
    places[0], waiting, count = first, 1, 0
    while waiting:
        waiting -= 1
        count += 1
        middle = places[waiting]
        for row in range(middle - width, middle + width + 1, width):
            for i in range(row - 1, row + 2):
                if flat[i]:
                    flat[i] = 0
                    places[waiting] = i
                    waiting += 1
    return count
