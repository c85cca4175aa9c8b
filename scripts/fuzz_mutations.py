"""Spoilt copies of a good file: bytes turned, cut, doubled; numbers and words of text replaced; arrays of archives
made other than they should be."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable

import numpy as np

Rng = np.random.Generator
Mutation = Callable[[bytes, Rng], bytes]

_LARGEST = 1 << 20
_NASTY_BYTES = (b"\x00", b"\xff", b"\x7f", b"\xff\xff\xff\xff", b"\x00\x00\x00\x80", b"\xef\xbb\xbf", b"\r", b"\n" * 9)
_NASTY_WORDS = (
    *("nan", "NaN", "inf", "-inf", "-Infinity", "1e999", "-1e308", "1e-320", "0", "-1", "-0.0", "2147483648"),
    *("99999999999999999999", "9223372036854775807", "1" * 400, "0x10", "1_0", "٣", "null", "true", '""', '"', "[]"),
    *("{}", "[" * 2000, '{"a":' * 1500, "\\u0000", "../../../etc/passwd", "/dev/zero", "file:///etc/passwd", "%s%n"),
    *("&lol;", "<!ENTITY a 'b'>", "!!python/object/apply:os.system", "cos\nsystem\n", "\U0001f4a5" * 30, "a" * 70000),
)
_TOKEN = re.compile(rb"[-+]?\d[\d.eE+-]*|[A-Za-z_][A-Za-z_0-9]*|[^\sA-Za-z0-9]")


def mutate(data: bytes, kind: str, rng: Rng) -> bytes:
    """One to six mutations; kind: "text", "binary" or "npz" (which gets whole archives with other arrays as well)."""
    if kind == "npz" and rng.random() < 0.75:
        return spoil_archive(data, rng)
    choices: tuple[Mutation, ...] = _TEXT if kind == "text" else _BINARY
    for _ in range(int(rng.integers(1, 7))):
        data = choices[int(rng.integers(len(choices)))](data, rng)[:_LARGEST]
    return data


def _span(data: bytes, rng: Rng, longest: int = 64) -> tuple[int, int]:
    a = int(rng.integers(0, len(data) + 1))
    return a, min(len(data), a + int(rng.integers(0, longest + 1)))


def _flip(data: bytes, rng: Rng) -> bytes:
    if not data:
        return data
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        out[int(rng.integers(len(out)))] ^= 1 << int(rng.integers(8))
    return bytes(out)


def _cut(data: bytes, rng: Rng) -> bytes:
    return data[: int(rng.integers(0, len(data) + 1))]


def _remove(data: bytes, rng: Rng) -> bytes:
    a, b = _span(data, rng)
    return data[:a] + data[b:]


def _double(data: bytes, rng: Rng) -> bytes:
    a, b = _span(data, rng, 4096)
    return data[:b] + data[a:b] * int(rng.choice([1, 1, 2, 50])) + data[b:]


def _insert(data: bytes, rng: Rng) -> bytes:
    a, _ = _span(data, rng)
    extra = _NASTY_BYTES[int(rng.integers(len(_NASTY_BYTES)))] if rng.random() < 0.5 else rng.bytes(8)
    return data[:a] + extra + data[a:]


def _integer(data: bytes, rng: Rng) -> bytes:
    """A little- or big-endian integer or float of the file becomes an extreme one."""
    size = int(rng.choice([1, 2, 4, 8]))
    if len(data) < size:
        return data
    a = int(rng.integers(0, min(len(data) - size + 1, 4096 if rng.random() < 0.7 else len(data))))
    extremes = (0, 1, -1, 2 ** (8 * size - 1) - 1, -(2 ** (8 * size - 1)))
    if size >= 4 and rng.random() < 0.3:
        value = np.array(rng.choice([np.nan, np.inf, -1e30, 1e-40]), f"<f{size}").tobytes()
    else:
        number = extremes[int(rng.integers(len(extremes)))]
        value = number.to_bytes(size, "big" if rng.random() < 0.3 else "little", signed=True)
    return data[:a] + value + data[a + size :]


def _word(data: bytes, rng: Rng) -> bytes:
    """A word or number becomes a nasty one, or another word of the file."""
    tokens = list(_TOKEN.finditer(data[:200_000]))
    if not tokens:
        return data
    hit = tokens[int(rng.integers(len(tokens)))]
    if rng.random() < 0.3:
        new = tokens[int(rng.integers(len(tokens)))].group()
    else:
        new = _NASTY_WORDS[int(rng.integers(len(_NASTY_WORDS)))].encode()
    return data[: hit.start()] + new + data[hit.end() :]


def _line(data: bytes, rng: Rng) -> bytes:
    """A line is lost, doubled, moved or repeated very often."""
    lines = data.split(b"\n")
    k = int(rng.integers(len(lines)))
    what = int(rng.integers(4))
    if what == 0:
        del lines[k]
    elif what == 1:
        lines.insert(k, lines[k])
    elif what == 2:
        lines.insert(int(rng.integers(len(lines))), lines.pop(k))
    else:
        lines[k : k + 1] = [lines[k]] * int(rng.choice([30, 2000]))
    return b"\n".join(lines)


_BINARY: tuple[Mutation, ...] = (_flip, _flip, _cut, _remove, _double, _insert, _integer, _integer, _integer)
_TEXT: tuple[Mutation, ...] = (_word, _word, _word, _word, _line, _line, _cut, _remove, _flip, _insert)


# ---- archives ------------------------------------------------------------------------------------------------


def spoil_archive(data: bytes, rng: Rng) -> bytes:
    """A valid zip whose arrays are wrong: other values, shapes, types, headers, names; or compressed."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = {e.filename: archive.read(e) for e in archive.infolist()}
    for _ in range(int(rng.integers(1, 4))):
        name = str(rng.choice(sorted(entries)))
        entries[name] = _spoil_array(entries[name], rng)
    what = rng.random()
    if what < 0.1:
        del entries[str(rng.choice(sorted(entries)))]
    elif what < 0.2:
        entries[str(rng.choice(["x.npy", "../evil.npy", "/etc/x.npy", "a.txt", "ü.npy"]))] = entries[min(entries)]
    out = io.BytesIO()
    packed = zipfile.ZIP_DEFLATED if what > 0.95 else zipfile.ZIP_STORED
    with zipfile.ZipFile(out, "w", packed) as archive:
        for name, content in entries.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return out.getvalue()


def _spoil_array(content: bytes, rng: Rng) -> bytes:
    what = int(rng.integers(7))
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except Exception:  # spoilt before: any of numpy's
        what = 0
        array = np.zeros(0)
    if what == 0 or not array.size:  # nothing is left, perhaps of a shape that no other type can have
        return mutate(content, "binary", rng)
    if what == 1:  # a header that promises more than there is
        shape = tuple(int(x) for x in rng.choice([0, 1, 3, 10**9, 2**62], size=int(rng.integers(0, 5))))
        head = io.BytesIO()
        np.lib.format.write_array_header_1_0(head, {"descr": array.dtype.str, "fortran_order": False, "shape": shape})
        return head.getvalue() + content[-array.nbytes :]
    if array.dtype.kind == "U":
        text = str(array.ravel()[0]) if array.size else ""
        spoilt = mutate(text.encode(), "text", rng).decode("utf-8", errors="replace").replace("\0", " ")
        array = np.array(spoilt) if array.ndim == 0 else np.full(array.shape, spoilt[:60])
    elif what == 2:
        array = array[: int(rng.integers(0, len(array) + 1))] if array.ndim else array[None]
    elif what == 3:
        array = array.astype(str(rng.choice(["<f4", "<i8", "|b1", ">f8", "<u2", "<f2"])), casting="unsafe")
    elif what == 4:
        array = array[None] if rng.random() < 0.5 or array.ndim < 2 else array.swapaxes(0, 1)
    elif array.size:
        array = array.copy()
        hits = rng.integers(0, array.size, int(rng.integers(1, 6)))
        choices = [0, 1, -1, 2**31 - 1, 10**6] if array.dtype.kind in "iu" else [np.nan, np.inf, -1e300, 0, -1, 1e9]
        if array.dtype.kind == "b":
            choices = [True, False]
        array.flat[hits] = np.array(rng.choice(choices, len(hits))).astype(array.dtype, casting="unsafe")
    out = io.BytesIO()
    np.lib.format.write_array(out, array, (1, 0), allow_pickle=False)
    return out.getvalue()
