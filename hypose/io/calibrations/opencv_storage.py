"""The files of OpenCV's FileStorage, YAML or XML, as plain values: numbers, texts, lists and matrices at the top level.

Read here and not by OpenCV, whose parser can be made to corrupt the memory of the process by a damaged file (found by
fuzzing with OpenCV 5.0). Only what calibrations hold is understood: scalars, flat lists, `!!opencv-matrix`, and the
`!!opencv-nd-matrix` that OpenCV 5 makes of one-dimensional arrays; nested maps are passed over.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree

import numpy as np

from hypose.geometry import Array

Value = float | str | list[float | str] | Array
_KEY = re.compile(r"([A-Za-z_][\w.-]*)\s*:(?:\s+(.*)|)$")
_MOST_NUMBERS = 100_000


def parse_storage(text: str) -> dict[str, Value]:
    """The values of the top level by their keys; a matrix comes flat. ValueError with a reason for anything else."""
    if text.lstrip().startswith("<"):
        return _xml(text)
    return _yaml(text)


# ---- YAML ------------------------------------------------------------------------------------------------------


def _yaml(text: str) -> dict[str, Value]:
    out: dict[str, Value] = {}
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(("#", "%", "---"))]
    blocks: list[list[str]] = []
    for line in lines:
        starts = not line[0].isspace() and not line.startswith(("-", "]", "}"))
        if starts:
            blocks.append([line.rstrip()])
        elif not blocks:
            raise ValueError("it does not begin with a key")
        else:
            blocks[-1].append(line.strip())
    for first, *rest in blocks:
        if first == "...":
            break
        match = _KEY.match(first)
        if match is None:
            if first.startswith(("{", "[", '"')):
                raise ValueError("it is no YAML of OpenCV")
            continue
        value = _yaml_value((match[2] or "").strip(), rest)
        if value is not None:
            out[match[1]] = value
    if not out:
        raise ValueError("it holds no values")
    return out


def _yaml_value(first: str, rest: list[str]) -> Value | None:
    whole = " ".join([first, *rest]).strip()
    if first.startswith("!!opencv-matrix"):
        return _matrix(re.search(r"\bdata:\s*\[([^\]]*)\]", whole), *(_count(whole, k) for k in ("rows", "cols")))
    if first.startswith("!!opencv-nd-matrix"):
        sizes = re.search(r"\bsizes:\s*\[([^\]]*)\]", whole)
        return _matrix(re.search(r"\bdata:\s*\[([^\]]*)\]", whole), _product(sizes[1] if sizes else ""), 1)
    if whole.count("[") != whole.count("]"):
        raise ValueError("a list does not end")
    if whole.startswith("["):
        return [_scalar(item) for item in _items(whole.strip("[] "))]
    if whole.startswith("-") and not first:
        return [_scalar(line[1:].strip()) for line in rest if line.startswith("-")]
    if whole.startswith("{") or rest:
        return None
    return _scalar(first)


def _count(text: str, key: str) -> int:
    match = re.search(rf"\b{key}:\s*(\d{{1,5}})\b", text)
    return int(match[1]) if match else 0


def _product(sizes: str) -> int:
    """How many numbers a matrix of these sizes has; 0 when they are none."""
    counts = [int(s) if re.fullmatch(r"\d{1,5}", s, re.ASCII) else 0 for s in sizes.replace(",", " ").split()[:8]]
    return math.prod(counts) if counts else 0


def _matrix(data: re.Match[str] | None, rows: int, columns: int) -> Array:
    """Flat; empty when the numbers are not as many as rows and columns say, or no numbers."""
    numbers = [_scalar(item) for item in _items(data[1])] if data else []
    if len(numbers) != rows * columns or any(isinstance(n, str) for n in numbers):
        return np.zeros(0)
    return np.array(numbers, dtype=np.float64)


def _items(text: str) -> list[str]:
    items = text.replace(",", " ").split() if '"' not in text else re.findall(r'"([^"]*)"|([^\s,"]+)', text)
    if len(items) > _MOST_NUMBERS:
        raise ValueError(f"a list has more than {_MOST_NUMBERS} values")
    return [item if isinstance(item, str) else f'"{item[0]}"' if item[0] else item[1] for item in items]


def _scalar(text: str) -> float | str:
    """A number, or a text without its quotes. OpenCV writes 1. and .5, .Nan and -.Inf."""
    if text[:1] in ('"', "'"):
        return text.strip("\"'")
    word = text.lower().removeprefix("-").removeprefix("+")
    if word in (".nan", ".inf"):
        return float(text.replace(".", ""))
    plain = re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", text, re.IGNORECASE | re.ASCII)
    return float(text) if plain and len(text) < 64 else text


# ---- XML -------------------------------------------------------------------------------------------------------


def _xml(text: str) -> dict[str, Value]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # OpenCV writes none; entities can make a file huge
        raise ValueError("it has a DOCTYPE")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise ValueError(f"it is no XML ({error})") from None
    if root.tag != "opencv_storage":
        raise ValueError("it is no XML of OpenCV")
    out: dict[str, Value] = {}
    for element in root:
        if element.get("type_id") == "opencv-matrix":
            sizes = [(element.findtext(k) or "").strip() for k in ("rows", "cols")]
            rows, columns = (int(s) if re.fullmatch(r"\d{1,5}", s, re.ASCII) else 0 for s in sizes)
            data = re.match(r"([\s\S]*)", element.findtext("data") or "")
            out[element.tag] = _matrix(data, rows, columns)
        elif element.get("type_id") == "opencv-nd-matrix":
            data = re.match(r"([\s\S]*)", element.findtext("data") or "")
            out[element.tag] = _matrix(data, _product(element.findtext("sizes") or ""), 1)
        elif len(element) == 0:
            values = [_scalar(item) for item in _items((element.text or "").strip())]
            out[element.tag] = values[0] if len(values) == 1 else values
    return out
