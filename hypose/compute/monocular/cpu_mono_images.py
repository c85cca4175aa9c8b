"""numba: image evidence of monocular tracking in single passes."""

from __future__ import annotations

import math

import numpy as np

from hypose.compute.compiled import kernel

f4 = np.float32


@kernel
def strongest_gradient(image, out, size):
    """Scharr gradient (per px) of that channel of image (h, w, C) in which it is largest: out (h, w, 2), its length
    size (h, w); 0 along the border."""
    h, w, channels = image.shape
    for y in range(h):
        for x in range(w):
            if y == 0 or y == h - 1 or x == 0 or x == w - 1:
                out[y, x, 0] = out[y, x, 1] = size[y, x] = f4(0)
                continue
            best, bx, by = f4(-1), f4(0), f4(0)
            for c in range(channels):
                a, b, d = image[y - 1, x - 1, c], image[y - 1, x, c], image[y - 1, x + 1, c]
                e, f = image[y, x - 1, c], image[y, x + 1, c]
                g, i, j = image[y + 1, x - 1, c], image[y + 1, x, c], image[y + 1, x + 1, c]
                gx = f4(3) * (d - a + j - g) + f4(10) * (f - e)
                gy = f4(3) * (g - a + j - d) + f4(10) * (i - b)
                s = gx * gx + gy * gy
                if s > best:
                    best, bx, by = s, gx, gy
            k = f4(1 / 32)
            out[y, x, 0], out[y, x, 1] = bx * k, by * k
            size[y, x] = math.sqrt(best) * k


@kernel
def saturate(field, size, full):
    """field (h, w, 2) in units of a full edge, cut at 1, in place."""
    for y in range(size.shape[0]):
        for x in range(size.shape[1]):
            k = f4(1) / max(full, size[y, x])
            field[y, x, 0] *= k
            field[y, x, 1] *= k


@kernel
def weigh(field, boundaries, x0, y0, floor, out):
    """out = field (h, w, 2) times floor + (1 - floor) boundaries, which cover the part from (x0, y0) on (0 outside)."""
    h, w = boundaries.shape
    for y in range(field.shape[0]):
        for x in range(field.shape[1]):
            i, j = y - y0, x - x0
            k = floor
            if 0 <= i < h and 0 <= j < w:
                k += (f4(1) - floor) * boundaries[i, j]
            out[y, x, 0] = k * field[y, x, 0]
            out[y, x, 1] = k * field[y, x, 1]


@kernel
def flow_error(there, back, out):
    """Length of there(x) + back(x + there(x)), px: out (h, w); outside the picture the border's flow counts."""
    h, w = out.shape
    for y in range(h):
        for x in range(w):
            fx, fy = there[y, x, 0], there[y, x, 1]
            u, v = min(max(x + fx, f4(0)), f4(w - 1.001)), min(max(y + fy, f4(0)), f4(h - 1.001))
            i, j = int(u), int(v)
            a, b = u - f4(i), v - f4(j)
            s = f4(0)
            for c in range(2):
                top = back[j, i, c] * (f4(1) - a) + back[j, i + 1, c] * a
                bottom = back[j + 1, i, c] * (f4(1) - a) + back[j + 1, i + 1, c] * a
                r = (fx if c == 0 else fy) + top * (f4(1) - b) + bottom * b
                s += r * r
            out[y, x] = math.sqrt(s)


@kernel
def boundary_map(back, error, steep, wrong, out):
    """Motion boundaries (h, w): slope of the flow (Sobel sums over `steep`) plus its error over `wrong`, each cut
    at 1."""
    h, w = out.shape
    for y in range(h):
        ya, yb = max(y - 1, 0), min(y + 1, h - 1)
        for x in range(w):
            xa, xb = max(x - 1, 0), min(x + 1, w - 1)
            s = f4(0)
            for c in range(2):
                gx = back[ya, xb, c] - back[ya, xa, c] + back[yb, xb, c] - back[yb, xa, c]
                gx += f4(2) * (back[y, xb, c] - back[y, xa, c])
                gy = back[yb, xa, c] - back[ya, xa, c] + back[yb, xb, c] - back[ya, xb, c]
                gy += f4(2) * (back[yb, x, c] - back[ya, x, c])
                s += gx * gx + gy * gy
            out[y, x] = min(f4(1), math.sqrt(s) / steep) + min(f4(1), error[y, x] / wrong)
