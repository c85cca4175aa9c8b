"""Key points of a whole video in one JSON file: MMPose, COCO results and annotations, AlphaPose.

Sources: MMPose 1.3 (structures/utils.py split_instances, demo/topdown_demo_with_mmdet.py, whose frames count from 1;
apis/inferencers, whose frames count from 0); AlphaPose (utils/pPose_nms.py write_json); the COCO result format.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hypose.errors import InputError
from hypose.evidence.keypoints import parse_openpose
from hypose.geometry import Array
from hypose.io.files import read_json
from hypose.io.keypoints.keypoint_table import MAX_BYTES, KeypointTable, grouped, scored_points, whole_number

_KIND = "a key-point file of MMPose, COCO or AlphaPose"


def read_document(path: Path) -> Any:
    """The value of a JSON file within bounds; an InputError names it."""
    return read_json(path, _KIND, MAX_BYTES)


def read_keypoint_json(path: Path) -> KeypointTable:
    """The key points of one JSON file that holds all frames; which layout it has is seen from its content."""
    document = read_document(path)
    where = str(path)
    if isinstance(document, Mapping):
        if isinstance(document.get("instance_info"), list):
            return _mmpose(document["instance_info"], document.get("meta_info"), where)
        if isinstance(document.get("annotations"), list):
            return _coco(document["annotations"], document.get("images"), where)
        if document and all(isinstance(v, Mapping) and "people" in v for v in document.values()):
            return _alphapose_frames(document, where)
        if "people" in document:
            raise InputError(
                f"{where} holds the people of one frame; name the folder that has one such file per frame."
            )
    if isinstance(document, list):
        if all(isinstance(v, Mapping) and "instances" in v for v in document):
            return _mmpose(document, None, where)
        if document and all(isinstance(v, Mapping) and "keypoints" in v for v in document):
            return _coco(document, None, where)
    raise InputError(
        f"{where} is not {_KIND}: neither instance_info, instances, annotations, nor a list of keypoints is in it; "
        "export the key points again, or as OpenPose files."
    )


def _mmpose(frames: list[Any], meta: Any, where: str) -> KeypointTable:
    rows: list[tuple[int, Array]] = []
    numbers: list[int] = []
    scored = True
    for i, frame in enumerate(frames):
        if not isinstance(frame, Mapping) or not isinstance(frame.get("instances"), list):
            raise InputError(f"{where}, entry {i}: it has no list of instances; export the predictions again.")
        number = whole_number(frame.get("frame_id", i), f"{where}, entry {i}", "frame_id")
        numbers.append(number)
        for person in frame["instances"]:
            if not isinstance(person, Mapping) or "keypoints" not in person:
                raise InputError(f"{where}, frame {number}: a person has no keypoints; export the predictions again.")
            scores = person.get("keypoint_scores")
            scored = scored and scores is not None
            rows.append((number, scored_points(person["keypoints"], scores, f"{where}, frame {number}")))
    people = dict.fromkeys(numbers, np.zeros((0, 0, 3))) | grouped(rows, where)
    kind = "MMPose results" if meta is not None else "MMPose predictions"
    # all frames are listed, so the smallest number is the first frame's
    return KeypointTable(kind, people, min(numbers, default=0), _names_of_meta(meta), scored=scored)


def _names_of_meta(meta: Any) -> tuple[str, ...] | None:
    table = meta.get("keypoint_id2name") if isinstance(meta, Mapping) else None
    if not isinstance(table, Mapping) or not all(isinstance(v, str) for v in table.values()):
        return None
    names = [table.get(str(i)) for i in range(len(table))]
    return tuple(n for n in names if n is not None) if all(names) else None


def _coco(found: list[Any], images: Any, where: str) -> KeypointTable:
    numbers = _image_numbers(images)
    rows: list[tuple[int, Array]] = []
    plain_names, scored = True, True
    for i, person in enumerate(found):
        at = f"{where}, entry {i}"
        if not isinstance(person, Mapping):
            raise InputError(f"{at}: it is no table; export the results again.")
        flat, identity = person.get("keypoints"), person.get("image_id")
        if not isinstance(flat, list) or not flat or len(flat) % 3:
            raise InputError(f"{at}: keypoints must be a list of x, y, score for each point; export the results again.")
        if isinstance(identity, str):
            plain_names = plain_names and re.fullmatch(r"(0|[1-9]\d*)\.(jpg|png)", identity) is not None
            digits = re.findall(r"\d+", Path(identity).stem)
            if not digits or len(digits[-1]) > 12:
                raise InputError(f"{at}: image_id {identity[:40]!r} has no frame number; export the results again.")
            number = int(digits[-1])
        else:
            plain_names = False
            number = whole_number(identity, at, "image_id")
            number = numbers.get(number, number)
        points = scored_points([flat[k : k + 2] for k in range(0, len(flat), 3)], flat[2::3], at)
        if images is not None:  # annotations by hand: 0 not there, 1 hidden, 2 seen
            points[:, 2], scored = np.where(points[:, 2] > 0, 0.5 * np.minimum(points[:, 2], 2), 0), False
        rows.append((number, points))
    kind = "AlphaPose results" if any("box" in p or "idx" in p for p in found) else "COCO results"
    # AlphaPose names the frames of a video 0.jpg, 1.jpg, ...
    return KeypointTable(kind, grouped(rows, where), 0 if rows and plain_names else None, scored=scored)


def _image_numbers(images: Any) -> dict[int, int]:
    """Frame numbers by image id, from the images' file names where all of these end in a number."""
    if not isinstance(images, list):
        return {}
    out = {}
    for image in images:
        name, identity = (image.get("file_name"), image.get("id")) if isinstance(image, Mapping) else (None, None)
        digits = re.findall(r"\d+", Path(name).stem) if isinstance(name, str) else []
        if not digits or len(digits[-1]) > 12 or not isinstance(identity, int):
            return {}
        out[identity] = int(digits[-1])
    return out if len(set(out.values())) == len(out) else {}


def _alphapose_frames(document: Mapping[str, Any], where: str) -> KeypointTable:
    people: dict[int, Array] = {}
    for name, frame in document.items():
        digits = re.findall(r"\d+", Path(name).stem)
        if not digits or len(digits[-1]) > 12:
            raise InputError(f"{where}: the frame {name[:40]!r} has no number; export the results again.")
        people[int(digits[-1])] = parse_openpose(frame, source=f"{where}, frame {name}", raw=True)
    plain = all(re.fullmatch(r"(0|[1-9]\d*)\.(jpg|png)", n) for n in document)
    return KeypointTable("AlphaPose results (OpenPose form)", people, 0 if plain else None)
