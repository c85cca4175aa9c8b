"""The doctor's page: verdicts, figures per camera, and pictures of where key points miss the other cameras' view."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from hypose import __version__
from hypose.app.reports.result_pictures import jpeg, open_images
from hypose.app.reports.summary import page, picture_of
from hypose.calibration.diagnose_points import undistorted
from hypose.calibration.diagnostics import Cured, Observed, PersonReport
from hypose.cameras.camera import CameraRig, triangulate
from hypose.geometry import Image
from hypose.io.files import write_text
from hypose.io.recordings.recording import Recording
from hypose.pipeline.examine import window

_MEASURED, EXPECTED = (60, 200, 250), (60, 60, 235)  # BGR


def residual_picture(recording: Recording, observed: Observed, cured: Cured) -> Image | None:
    """All views at the frame with most key points: each key point, and a line to where the other cameras put it."""
    if observed.keypoints is None or len(recording.rig) < 3:
        return None
    few = window(recording, observed.keypoints.shape[1])
    seen = (observed.keypoints[..., 2] > 0.5).sum(2).min(0)
    row = int(np.argmax(seen))
    number = few.frames[min(row, len(few.frames) - 1)]
    uv, confidence = undistorted(recording.rig, observed.keypoints[:, row : row + 1])
    tiles = []
    images = open_images(recording)
    try:
        for c, (camera, view) in enumerate(zip(recording.rig, images, strict=True)):
            others = [k for k in range(len(images)) if k != c]
            points, _ = triangulate(
                CameraRig(tuple(recording.rig[k] for k in others)),
                uv[others, 0],
                np.where(confidence[others, 0] > 0.3, confidence[others, 0], 0.0),
            )
            picture = view.read(min(number + cured.keypoint_lag, recording.n_frames - 1))
            if picture is None:
                continue
            ratio = np.array(picture.shape[1::-1]) / np.array(camera.size)
            expected = (camera.project(points) + 0.5) * ratio - 0.5
            found = (observed.keypoints[c, row, :, :2] + 0.5) * ratio - 0.5
            tiles.append(_drawn(picture, found, expected, observed.keypoints[c, row, :, 2], camera.name))
    finally:
        for view in images:
            view.close()
    if not tiles:
        return None
    height = max(t.shape[0] for t in tiles)
    padded = [cv2.copyMakeBorder(t, 0, height - t.shape[0], 0, 4, cv2.BORDER_CONSTANT) for t in tiles]
    return np.asarray(np.concatenate(padded, 1), np.uint8)


def _drawn(picture: Image, found: np.ndarray, expected: np.ndarray, confidence: np.ndarray, name: str) -> Image:
    """The part of the picture around the person, 560 px high, with the key points and their misses."""
    known = (confidence > 0.3) & np.isfinite(expected).all(1)
    if not known.any():
        known = confidence > 0.3
    h, w = picture.shape[:2]
    box = found[known] if known.any() else np.array([[0, 0], [w - 1, h - 1]])
    margin = 0.15 * float(np.ptp(box, axis=0).max())
    x0, y0 = np.maximum(np.floor(box.min(0) - margin), 0).astype(int)
    x1, y1 = np.minimum(np.ceil(box.max(0) + margin), [w, h]).astype(int)
    part = picture[y0:y1, x0:x1]
    scale = 560 / max(part.shape[0], 1)
    part = cv2.resize(part, (max(1, round(part.shape[1] * scale)), 560), interpolation=cv2.INTER_AREA)
    for k in np.flatnonzero(known):
        a = tuple(int(v) for v in np.rint((found[k] - [x0, y0]) * scale))
        if np.isfinite(expected[k]).all():
            b = tuple(int(v) for v in np.rint(np.clip((expected[k] - [x0, y0]) * scale, -4000, 4000)))
            cv2.line(part, a, b, EXPECTED, 2, cv2.LINE_AA)
        cv2.circle(part, a, 4, _MEASURED, -1, cv2.LINE_AA)
    cv2.rectangle(part, (0, 0), (part.shape[1], 24), (30, 30, 30), -1)
    cv2.putText(part, name, (8, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
    return np.asarray(part, np.uint8)


def write_check_page(
    path: Path,
    title: str,
    report: PersonReport,
    sheet: Path,
    picture: Image | None,
    facts: Sequence[str],
    warnings: Sequence[str],
) -> None:
    """One file with everything inside."""
    e = html.escape
    verdict = (
        '<p class="good">No fault found.</p>'
        if report.healthy and not warnings
        else '<p class="bad">Something is wrong; see below.</p>'
    )
    rows = []
    for v in report.views:
        moved = "-" if v.change is None else f"{v.change.turn_deg:.2f}&deg;, {1000 * v.change.move_m:.0f} mm"
        lag = "-" if v.alignment is None else f"{v.alignment.lag:+.2f} &plusmn; {v.alignment.lag_sd:.2f}"
        cells = (_number(v.residual_px), _number(v.left_out_px), _number(v.tangency_px), lag, moved)
        found = [f for f in report.of(v.name) if f.fault]
        word = (
            '<span class="bad">' + e(", ".join(dict.fromkeys(f.kind for f in found))) + "</span>" if found else "fine"
        )
        rows.append(
            f"<tr><td>{e(v.name)}</td>" + "".join(f'<td class="n">{c}</td>' for c in cells) + f"<td>{word}</td>"
        )
    head = (
        "camera",
        "residual (px)",
        "left out (px)",
        "silhouette (px)",
        "key points early by (frames)",
        "a refinement moves it by",
        "verdict",
    )
    parts = [
        f"<h1>{e(title)}: is the calibration right?</h1>",
        verdict,
        "<h2>Findings</h2><ul>",
        *(f"<li>{'' if f.fault else 'Note: '}{e(f.sentence)}</li>" for f in report.findings),
        *(f"<li>{e(w)}</li>" for w in warnings),
        "</ul>" if report.findings or warnings else "<li>none</li></ul>",
        "<h2>Cameras</h2><table><tr>" + "".join(f"<th>{e(h)}</th>" for h in head) + "</tr>",
        *rows,
        "</table><p class='dim'>Residual: median distance of the camera's key points from the triangulation of all "
        "views; left out: of the other views. Silhouette: by how much the planes that touch the person differ from "
        "those of the other views.</p>",
    ]
    if picture is not None:
        parts.append("<h2>Key points, and where the other cameras put them</h2>")
        parts.append(picture_of(jpeg(picture, picture.shape[1], 85), "jpeg"))
    if sheet.is_file():
        parts.append("<h2>Masks</h2>" + picture_of(sheet.read_bytes(), "png"))
    parts.append("<h2>Notes</h2><ul>" + "".join(f"<li>{e(f)}</li>" for f in facts) + "</ul>")
    parts.append(f"<p class='dim'>hypose {__version__}</p>")
    write_text(path, page(f"{title}: check", "\n".join(parts)))


def _number(value: float) -> str:
    return "-" if value != value else f"{value:.1f}"
