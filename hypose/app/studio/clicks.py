"""The routes of the Click screen: clicked joints to a pose while they are clicked, and kept as a start."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from hypose.app.studio import click_fit
from hypose.app.studio.answers import answer, block_answer, body_of, told
from hypose.app.studio.asked import choice, number, whole
from hypose.app.studio.catalog import Catalog, Item
from hypose.app.studio.job_kinds import is_name
from hypose.app.studio.recordings import Recordings
from hypose.app.studio.view_bundle import ViewResult, view_bundle
from hypose.app.studio.view_result import first_frame
from hypose.body.body import Body
from hypose.body.motion import Motion, isotropic
from hypose.body.ready_bodies import JOINT_NAMES, human
from hypose.errors import InputError
from hypose.geometry import Array
from hypose.io.files import read_json
from hypose.io.motions.results import ResultsFolder, load_body, load_motion
from hypose.io.recordings.recording import Recording
from hypose.io.videos.video import frame_size
from hypose.pipeline.one_camera import LEAST_POINTS

_FORMAT = "hypose-clicks"


def routes(catalog: Catalog, recordings: Recordings) -> list[Route]:
    """The routes."""

    async def joints(request: Request) -> Response:
        return answer([{"joint": k, "title": v} for k, v in click_fit.CLICK_JOINTS.items()])

    async def fit(request: Request) -> Response:
        value = await body_of(request)
        return answer(await run_in_threadpool(lambda: _fitted(value, catalog, recordings)))

    async def body(request: Request) -> Response:
        asked = dict(request.query_params)
        data = await run_in_threadpool(lambda: _body_block(asked, catalog, recordings))
        return block_answer(data)

    async def save(request: Request) -> Response:
        value, item = await body_of(request), catalog.find("recording", request.path_params["id"])
        return answer(await run_in_threadpool(lambda: _save(value, item, catalog, recordings)), 201)

    async def one(request: Request) -> Response:
        item, name = catalog.find("recording", request.path_params["id"]), request.path_params["name"]
        return answer(await run_in_threadpool(lambda: _load(item, name)))

    return [
        Route("/api/click-joints", told(joints)),
        Route("/api/click-body", told(body)),
        Route("/api/fit-clicks", told(fit), methods=["POST"]),
        Route("/api/recordings/{id}/starts", told(save), methods=["POST"]),
        Route("/api/recordings/{id}/starts/{name}", told(one)),
    ]


def _fitted(value: dict[str, Any], catalog: Catalog, recordings: Recordings) -> dict[str, Any]:
    item = _recording(value, catalog)
    recording = recordings.load(item)
    clicks = click_fit.clicks_of(_seen_straight(value.get("views"), recording), recording.rig)
    body, pose, measured = _body(value, item, catalog)
    height = _height(value.get("height"), measured, recording)
    if not measured:
        body = click_fit.sized(body, height)
    start = _pose(value.get("start"), body) if value.get("start") is not None else pose
    found = click_fit.fit_clicks(body, clicks, start, measured or height is not None, correct=pose is not None)
    return click_fit.shown(body, clicks, found)


def _seen_straight(views: Any, recording: Recording) -> Any:
    """The views of a request with their points in undistorted pixels of K: those that were clicked in the picture as it
    was recorded ("recorded": true) have its lens taken out."""
    if not isinstance(views, list):
        return views
    return [_straight(v, recording) if isinstance(v, dict) and v.get("recorded") is True else v for v in views]


def _straight(view: dict[str, Any], recording: Recording) -> dict[str, Any]:
    name = choice(view.get("camera"), "camera", recording.rig.names)
    points = view.get("points")
    if not isinstance(points, list) or not points or not all(isinstance(p, dict) for p in points):
        return view
    index = recording.rig.names.index(name)
    camera, shift = recording.rig[index], np.asarray(recording.views[index].image_shift)
    uv = np.array([[number(p.get(k), f"{k} of a click (px)", -1e5, 1e5) for k in ("x", "y")] for p in points])
    straight = camera.undistort_points(uv + shift)
    moved = [{**p, "x": float(x), "y": float(y)} for p, (x, y) in zip(points, straight, strict=True)]
    return {**{k: v for k, v in view.items() if k != "recorded"}, "points": moved}


def _height(value: Any, measured: bool, recording: Recording) -> float | None:
    """m; of a person who was not measured the recording may know it."""
    height = value or (None if measured else recording.subject_height)
    return None if height is None else number(height, "the height (m)", 0.4, 2.8)


def _body_block(asked: dict[str, str], catalog: Catalog, recordings: Recordings) -> bytearray:
    """The body that clicks are fitted with, as a block of one frame in which it stands at rest."""
    item = _recording(asked, catalog)
    try:
        wanted = float(asked["height"]) if "height" in asked else None
    except ValueError:
        raise InputError("The height must be a number of metres.") from None
    body, _, measured = _body({**asked, "frame": 0}, item, catalog)
    if not measured:
        body = click_fit.sized(body, _height(wanted, measured, recordings.load(item)))
    rest = np.zeros((1, body.skeleton.dof))
    one, unknown = np.zeros(1, dtype=bool), np.full(1, np.nan)
    around = isotropic(np.full((1, len(body.skeleton.joint_names)), np.nan))
    motion = Motion(body.skeleton, np.zeros(1), body.joints(rest), rest, around, one, one, np.zeros(1, int), unknown)
    return view_bundle(ViewResult(item.path.name, motion, body))


def _recording(value: dict[str, Any], catalog: Catalog) -> Item:
    given = value.get("recording")
    if isinstance(given, str):
        return catalog.find("recording", given)
    if isinstance(value.get("result"), str):
        folder = catalog.recording_of(catalog.find("result", value["result"]).path)
        if folder is not None:
            return catalog.find("recording", catalog.id_of("recording", folder))
    raise InputError("Say in which recording the joints were clicked.")


def _body(value: dict[str, Any], item: Item, catalog: Catalog) -> tuple[Body, Array | None, bool]:
    """The person's body; the pose that is corrected; whether the body was measured."""
    frame = whole(value.get("frame"), "the frame in which the joints were clicked", 0, 10**9)
    if isinstance(value.get("result"), str):
        folder = ResultsFolder(catalog.find("result", value["result"]).path)
        changed = folder.motion.stat().st_mtime_ns if folder.motion.is_file() else 0
        return *_corrected(folder, changed, frame), True
    measured = item.path / "subject" / "body.npz"
    return (load_body(measured), None, True) if measured.is_file() else (human(), None, False)


@lru_cache(maxsize=4)
def _corrected(folder: ResultsFolder, changed: int, frame: int) -> tuple[Body, Array | None]:
    """The body of a result as it was written last, and its pose in a frame of the recording. Asked again and again
    while a joint is dragged, and a long motion takes long to read."""
    motion, body = load_motion(folder.motion), load_body(folder.file("body.npz"))
    row = frame - first_frame(motion)
    if motion.poses is None or not 0 <= row < len(motion) or not np.isfinite(motion.poses[row]).all():
        return body, None
    return body, motion.poses[row].copy()


def _pose(value: Any, body: Body) -> Array:
    if not isinstance(value, list) or len(value) != body.skeleton.dof:
        raise InputError(f"A pose has {body.skeleton.dof} numbers.")
    return body.skeleton.clamp(np.array([number(v, "a number of the pose", -1e6, 1e6) for v in value]))


def _save(value: dict[str, Any], item: Item, catalog: Catalog, recordings: Recordings) -> dict[str, Any]:
    """Keep clicks and the pose they give in starts/NAME.json."""
    name = value.get("name") or f"frame-{value.get('frame')}"
    if not isinstance(name, str) or not is_name(name):
        raise InputError("Give the start a name of letters, digits, - and _.")
    if not catalog.contains(item.path / "starts"):
        raise InputError(f"The starts of {item.path.name} lie outside the served folder.")
    if isinstance(value.get("result"), str):  # a correction belongs to the result that was tracked from it
        name = free_name(item.path / "starts", name)
    value = {**value, "views": _seen_straight(value.get("views"), recordings.load(item))}
    found = _fitted({**value, "recording": item.id}, catalog, recordings)
    keep = {k: value[k] for k in ("frame", "views", "height", "result") if value.get(k) is not None}
    keep |= {k: whole(value[k], f"the frame {k}", 0, 10**9) for k in ("since", "until") if value.get(k) is not None}
    keep |= _for_one_camera(value["views"], value.get("camera"), recordings.load(item))
    document = {"format": _FORMAT, "version": 1, **keep, **{k: found[k] for k in ("pose", "joint_sd", "rms_px")}}
    ResultsFolder(item.path / "starts").write_json(f"{name}.json", document)
    return {"name": name, **document}


def free_name(starts: Path, name: str) -> str:
    """name, or with a number behind it the first under which no clicks are kept."""
    number, free = 2, name
    while (starts / f"{free}.json").exists():
        free, number = f"{name}-{number}", number + 1
    return free


def _for_one_camera(views: Sequence[Mapping[str, Any]], wanted: Any, recording: Recording) -> dict[str, Any]:
    """camera and joints as `hypose track --recipe monocular --start FILE` reads them (hypose.pipeline.one_camera):
    of the wanted camera when enough is clicked there, else the one with most clicks; in pixels of the picture as it was
    recorded. Joints behind something only where there are too few others."""
    view = max(views, key=lambda v: (v["camera"] == wanted and len(v["points"]) >= LEAST_POINTS, len(v["points"])))
    index = recording.rig.names.index(view["camera"])
    camera, source = recording.rig[index], recording.views[index]
    points = [p for p in view["points"] if p["joint"] in JOINT_NAMES]
    clear = [p for p in points if not p.get("occluded")]
    points = clear if len(clear) >= LEAST_POINTS else points
    if not points or source.source is None:
        return {"camera": source.name, "joints": {}}
    origin, rays = camera.pinhole().rays(np.array([[p["x"], p["y"]] for p in points], dtype=np.float64))
    seen = camera.project(origin + rays) - np.asarray(source.image_shift)
    stored = (seen + 0.5) * np.array(frame_size(source.source)) / np.array(camera.size) - 0.5
    return {"camera": source.name, "joints": {p["joint"]: stored[k] for k, p in enumerate(points)}}


def _load(item: Item, name: str) -> dict[str, Any]:
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,79}", name):
        raise InputError(f"{name[:40]!r} is no name of a start.")
    path = item.path / "starts" / f"{name}.json"
    value = read_json(path, "a start")
    if not isinstance(value, dict) or value.get("format") != _FORMAT:
        raise InputError(f"The start {name} was not written by hypose.")
    return value
