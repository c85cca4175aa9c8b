"""numba: decoded picture -> working size -> difference from the room -> cleaned mask, as integers where the result
depends on it, so that the plain definitions in images.py give the same bytes."""

from __future__ import annotations

import numpy as np

from hypose.compute.compiled import kernel

f4 = np.float32
u8 = np.uint64  # an index of this type needs no test for "counted from the end"


@kernel
def _sum_rows(source, row, weights, first, width, sums):
    """sums (width,) u2 = weighted rows of source (H, 3 W) u1 from `row` on, columns from `first`; the weights (L,) u2
    add up to at most 257. Four rows at a time: what limits is how often `sums` is read and written."""
    lines = weights.shape[0]
    w = np.zeros(4, np.uint16)
    for k in range(0, lines, 4):
        for j in range(4):
            w[j] = weights[k + j] if k + j < lines else 0
        wa, wb, wc, wd = w[0], w[1], w[2], w[3]
        a = source[row + k, first : first + width]
        b = source[row + min(k + 1, lines - 1), first : first + width]
        c = source[row + min(k + 2, lines - 1), first : first + width]
        d = source[row + min(k + 3, lines - 1), first : first + width]
        if k == 0:
            for i in range(width):
                sums[i] = wa * a[i] + wb * b[i] + wc * c[i] + wd * d[i]
        else:
            for i in range(width):
                sums[i] += wa * a[i] + wb * b[i] + wc * c[i] + wd * d[i]


@kernel
def shrink_blocks(image, across, down, y0, y1, x0, x1, out):
    """out (h + 3, w + 3) u8 [1 + y, 1 + x] = average of the across x down pixels of image (H, W, 3) u1 that begin at
    (across x, down y), for y0 <= y < y1, x0 <= x < x1, packed: blue + green 2^21 + red 2^42."""
    source = image.reshape(image.shape[0], image.shape[1] * 3)
    first, width = 3 * across * x0, 3 * across * (x1 - x0)
    sums, blocks = np.empty(width, np.uint16), np.empty(width, np.uint16)
    weights = np.ones(down, np.uint16)
    inverse = u8((16777216 + across * down // 2) // (across * down))
    for y in range(y0, y1):
        made = out[y + 1]
        if across == 1 and down == 1:
            line = source[y]
            for x in range(x0, x1):
                i = u8(3 * x)
                made[x + 1] = u8(line[i]) | (u8(line[i + u8(1)]) << u8(21)) | (u8(line[i + u8(2)]) << u8(42))
            continue
        _sum_rows(source, down * y, weights, first, width, sums)
        for i in range(3 * across * (x1 - x0 - 1) + 3):  # all sums, though one in `across` is used: it vectorises
            blocks[i] = sums[i]
        for k in range(1, across):
            shifted = sums[3 * k : width]
            for i in range(3 * across * (x1 - x0 - 1) + 3):
                blocks[i] += shifted[i]
        for x in range(x0, x1):
            i = u8(3 * across * (x - x0))
            blue = (blocks[i] * inverse + u8(8388608)) >> u8(24)
            green = (blocks[i + u8(1)] * inverse + u8(8388608)) >> u8(24)
            red = (blocks[i + u8(2)] * inverse + u8(8388608)) >> u8(24)
            made[x + 1] = blue | (green << u8(21)) | (red << u8(42))


@kernel
def shrink_weighted(image, columns, column_weights, rows, row_weights, y0, y1, x0, x1, out):
    """out (h + 3, w + 3) u8 [1 + y, 1 + x] = area average of image (H, W, 3) u1 for y0 <= y < y1, x0 <= x < x1, packed
    as in shrink_blocks.

    Pixel x is the sum of column_weights[x, k] (in 256ths) of the columns columns[x] + k; rows alike, and rounded to
    16ths in between. Three colours are summed in one word."""
    source = image.reshape(image.shape[0], image.shape[1] * 3)
    first, last = columns[x0], columns[x1 - 1] + column_weights.shape[1]
    width = 3 * (last - first)
    sums = np.empty(width, np.uint16)
    packed = np.empty(last - first, np.uint64)
    taps = column_weights.shape[1]
    half, mask = u8(2048 | (2048 << 21) | (2048 << 42)), u8(255 | (255 << 21) | (255 << 42))
    for y in range(y0, y1):
        _sum_rows(source, rows[y], row_weights[y], 3 * first, width, sums)
        for i in range(width):
            sums[i] = (sums[i] + np.uint16(8)) >> np.uint16(4)
        for x in range(last - first):
            i = u8(3 * x)
            packed[x] = u8(sums[i]) | (u8(sums[i + u8(1)]) << u8(21)) | (u8(sums[i + u8(2)]) << u8(42))
        made = out[y + 1]
        for x in range(x0, x1):
            i, total = u8(columns[x] - first), half
            for k in range(taps):
                total += u8(column_weights[x, k]) * packed[i + u8(k)]
            made[x + 1] = (total >> u8(12)) & mask


@kernel
def unpack(small, y0, y1, x0, x1, out):
    """out (h, w, 3) u1 in the box = the packed pixels small (h + 3, w + 3) u8."""
    for y in range(y0, y1):
        line, made = small[y + 1], out[y].reshape(-1)
        for x in range(x0, x1):
            p, i = line[x + 1], u8(3 * x)
            made[i] = p & u8(255)
            made[i + u8(1)] = (p >> u8(21)) & u8(255)
            made[i + u8(2)] = (p >> u8(42)) & u8(255)


@kernel
def remap(small, corner, parts, y0, y1, x0, x1, out):
    """out (h, w, 3) u1 in the box = the packed pixels small (h + 3, w + 3) u8 at corner (h, w) plus the parts
    (h, w, 2), in 32nds. Three colours are blended in one word."""
    flat = small.reshape(-1)
    step = u8(small.shape[1])
    one, half = u8(1), u8(512 | (512 << 21) | (512 << 42))
    for y in range(y0, y1):
        made, at, part = out[y].reshape(-1), corner[y], parts[y].reshape(-1)
        for x in range(x0, x1):
            p = u8(at[x])
            fx, fy = u8(part[u8(2 * x)]), u8(part[u8(2 * x + 1)])
            upper = (u8(32) - fx) * flat[p] + fx * flat[p + one]
            p += step
            lower = (u8(32) - fx) * flat[p] + fx * flat[p + one]
            value = (u8(32) - fy) * upper + fy * lower + half
            i = u8(3 * x)
            made[i] = (value >> u8(10)) & u8(255)
            made[i + u8(1)] = (value >> u8(31)) & u8(255)
            made[i + u8(2)] = (value >> u8(52)) & u8(255)


@kernel
def _darker(picture, room, square, darkest, lightest, chroma, made):
    """made (n,) u1: ones become 2 where the picture (3 n,) is the room (3 n,), darker; by itself it vectorises."""
    for x in range(made.shape[0]):
        a, b, c = f4(picture[3 * x]), f4(picture[3 * x + 1]), f4(picture[3 * x + 2])
        p, q, r = room[3 * x], room[3 * x + 1], room[3 * x + 2]
        s = (a * p + b * q + c * r) / square[x]
        a -= s * p
        b -= s * q
        c -= s * r
        dark = (s > darkest) & (s < lightest) & (a * a + b * b + c * c < chroma)
        made[x] = np.uint8(made[x] << np.uint8(dark & (made[x] == 1)))


@kernel
def differ(image, low, high, mean, square, shadow, darkest, lightest, chroma, y0, y1, x0, x1, out):
    """out (h, w) u1 in the box: 0 = the room, 1 = something else, 2 = the room, darker. image (h, w, 3) u1 between
    low and high (same type) is the room. For the shadow test (if shadow): mean (h, w, 3) f4, square (h, w) f4."""
    width = x1 - x0
    words = np.zeros(3 * ((width + 7) // 8), np.uint64)
    bad = words.view(np.uint8)
    for y in range(y0, y1):
        picture, least, most = image[y].reshape(-1), low[y].reshape(-1), high[y].reshape(-1)
        made = out[y, x0:x1]
        part, under, above = picture[3 * x0 : 3 * x1], least[3 * x0 : 3 * x1], most[3 * x0 : 3 * x1]
        for i in range(3 * width):
            bad[i] = np.uint8((part[i] < under[i]) | (part[i] > above[i]))
        for k in range(0, width, 8):  # eight pixels at a time: most of them are the room
            word = u8(3 * (k // 8))
            if (words[word] | words[word + u8(1)] | words[word + u8(2)]) == 0:
                for x in range(k, min(k + 8, width)):
                    made[u8(x)] = 0
                continue
            for x in range(k, min(k + 8, width)):
                i = u8(3 * x)
                made[u8(x)] = bad[i] | bad[i + u8(1)] | bad[i + u8(2)]
        if not shadow:
            continue
        room = mean[y].reshape(-1)[3 * x0 : 3 * x1]
        first, last = 0, width
        while first < last and made[first] == 0:
            first += 1
        while last > first and made[last - 1] == 0:
            last -= 1
        _darker(
            part[3 * first : 3 * last],
            room[3 * first : 3 * last],
            square[y, x0 + first : x0 + last],
            darkest,
            lightest,
            chroma,
            made[first:last],
        )


@kernel
def _all_of_three(a, b, c, out):
    for x in range(out.shape[0]):
        out[x] = a[x] & b[x] & c[x]


@kernel
def _any_of_three(a, b, c, out):
    for x in range(out.shape[0]):
        out[x] = a[x] | b[x] | c[x]


@kernel
def without_shadows(codes, out):
    """out (h, w) u1 = codes (h, w) > 0, less every 3 x 3 block of twos (as much of it as lies inside the picture)."""
    h, w = codes.shape
    # row y of these is picture row y - 1; beyond the picture there is shadow to erode, and nothing to dilate
    twos, whole = np.ones((h + 2, w + 2), np.uint8), np.zeros((h + 2, w + 2), np.uint8)
    line = np.ones(w + 2, np.uint8)
    for y in range(h):
        row, two = codes[y], twos[y + 1, 1 : w + 1]
        for x in range(w):
            two[x] = row[x] == 2
    for y in range(1, h + 1):
        _all_of_three(twos[y - 1], twos[y], twos[y + 1], line)
        _all_of_three(line[:w], line[1 : w + 1], line[2:], whole[y, 1 : w + 1])
    for y in range(1, h + 1):
        _any_of_three(whole[y - 1], whole[y], whole[y + 1], line)
        row, left, middle, right, made = codes[y - 1], line[:w], line[1 : w + 1], line[2:], out[y - 1]
        for x in range(w):
            made[x] = np.uint8(row[x] > 0) & np.uint8((left[x] | middle[x] | right[x]) ^ np.uint8(1))


@kernel
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def _label(mask, value, reach, starts, ends, rows, parent):
    """Runs of `value` in mask (h, w), joined to regions (reach 1: also over corners); returns their number.

    starts, ends, rows (n,) of the runs; parent (n,): the first run of the region."""
    h, w = mask.shape
    n = 0
    before = 0  # first run of the row above
    for y in range(h):
        line = mask[y]
        begin = n
        total = 0
        for x in range(w):  # vectorises; most rows hold nothing
            total += line[x]
        if total == 0 and value == 1:
            before = n
            continue
        x = 0
        other = before
        while x < w:
            while x < w and line[u8(x)] != value:
                x += 1
            if x == w:
                break
            first = x
            while x < w and line[u8(x)] == value:
                x += 1
            starts[n], ends[n], rows[n], parent[n] = first, x, y, n
            while other < begin and ends[other] + reach <= first:
                other += 1
            k = other
            while k < begin and starts[k] < x + reach:
                a, b = _root(parent, k), _root(parent, n)
                if a < b:
                    parent[b] = a
                else:
                    parent[a] = b
                k += 1
            n += 1
        before = begin
    return n


@kernel
def clean_regions(mask, hole_px, keep_share, keep_gap, out):
    """Fill the holes of at most hole_px in mask (h, w) u1 (which is changed), keep the biggest region and what lies
    near it; out (h, w) u1, zero before. See images.clean_regions."""
    h, w = mask.shape
    most = h * (w // 2 + 1)
    starts, ends = np.empty(most, np.int32), np.empty(most, np.int32)
    rows, parent = np.empty(most, np.int32), np.empty(most, np.int32)
    area = np.empty(most, np.int64)
    if hole_px > 0:
        n = _label(mask, 0, 0, starts, ends, rows, parent)
        for i in range(n):
            area[i] = 0
        for i in range(n):
            area[_root(parent, i)] += ends[i] - starts[i]
        for i in range(n):
            if area[_root(parent, i)] <= hole_px:
                line = mask[rows[i]]
                for x in range(starts[i], ends[i]):
                    line[x] = 1
    n = _label(mask, 1, 1, starts, ends, rows, parent)
    if n == 0:
        return
    box = np.empty((n, 4), np.int32)  # left, top, right, bottom of each region
    for i in range(n):
        area[i] = 0
        box[i, 0], box[i, 1], box[i, 2], box[i, 3] = w, h, 0, 0
    main = 0
    for i in range(n):
        k = _root(parent, i)
        area[k] += ends[i] - starts[i]
        box[k, 0] = min(box[k, 0], starts[i])
        box[k, 1] = min(box[k, 1], rows[i])
        box[k, 2] = max(box[k, 2], ends[i])
        box[k, 3] = max(box[k, 3], rows[i] + 1)
    for i in range(n):
        if area[i] > area[main]:
            main = i
    side = max(box[main, 2] - box[main, 0], box[main, 3] - box[main, 1])
    for i in range(n):
        k = _root(parent, i)
        if k != main:
            gap = max(box[k, 0] - box[main, 2], box[main, 0] - box[k, 2])
            gap = max(gap, max(box[k, 1] - box[main, 3], box[main, 1] - box[k, 3]))
            if keep_share >= 1 or area[k] < keep_share * area[main] or gap > keep_gap * side:
                continue
        line = out[rows[i]]
        for x in range(starts[i], ends[i]):
            line[x] = 1


@kernel
def order_statistic(stack, hidden, rank, out):
    """out (P, 3) u1 of stack (N, P, 3) u1: see images.order_statistic; hidden (N or 0, P) bool, rank (P,) u2.

    The value is found bit by bit: how many are smaller than it would be with this bit? All in vector lanes."""
    n, pixels = stack.shape[0], stack.shape[1]
    block = 128
    guess, found, below = np.empty(3 * block, np.uint8), np.empty(3 * block, np.uint8), np.empty(3 * block, np.uint16)
    wanted = np.empty(3 * block, np.uint16)
    flat = stack.reshape(n, 3 * pixels)
    free = np.empty((n, 3 * block), np.uint8)
    result = out.reshape(-1)
    for first in range(0, pixels, block):
        size = 3 * min(block, pixels - first)
        for i in range(size):
            wanted[i] = rank[first + i // 3]
            found[i] = 0
        for k in range(hidden.shape[0]):
            for i in range(size):
                free[k, i] = 1 - hidden[k, first + i // 3]
        for bit in range(7, -1, -1):
            for i in range(size):
                guess[i] = found[i] | np.uint8(1 << bit)
                below[i] = 0
            for k in range(n):
                line = flat[k, 3 * first : 3 * first + size]
                if hidden.shape[0] > 0:
                    seen = free[k]
                    for i in range(size):
                        below[i] = np.uint16(below[i] + np.uint16((line[i] < guess[i]) & seen[i]))
                else:
                    for i in range(size):
                        below[i] = np.uint16(below[i] + np.uint16(line[i] < guess[i]))
            for i in range(size):
                if below[i] <= wanted[i]:
                    found[i] = guess[i]
        for i in range(size):
            result[3 * first + i] = found[i]
