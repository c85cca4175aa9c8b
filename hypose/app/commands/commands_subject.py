"""`hypose subject`: a person's body from a recording or from a scan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hypose.app.commands.commands_track import set_threads
from hypose.app.commands.console import Stages, note, say
from hypose.app.commands.options import Seed, Threads, number
from hypose.errors import InputError

if TYPE_CHECKING:
    from hypose.io.recordings.recording import Recording
    from hypose.pipeline.subject_from_motion import SubjectEstimate


def subject(
    recording: Annotated[
        Path | None, typer.Argument(help="Folder with recording.toml, that file, or a Pose2Sim project.")
    ] = None,
    mesh: Annotated[
        Path | None, typer.Option(help="A scan of the person instead of a recording: obj, ply, stl, off, glb or npz.")
    ] = None,
    unit: Annotated[str, typer.Option(help="The scan's unit: m, cm, mm or in.")] = "m",
    height: Annotated[
        float | None, number("The person's height in metres, when known.", 0.5, 2.5, unit="metres")
    ] = None,
    mass: Annotated[
        float | None, number("The person's mass in kilograms, when known.", 8, 350, unit="kilograms")
    ] = None,
    start: Annotated[
        str, typer.Option(help="The first frame's pose: hull (find out), a, t, standing, hands-up.")
    ] = "hull",
    frames: Annotated[str | None, typer.Option(help="first:stop, counted from 0. [default: all]")] = None,
    poses: Annotated[int, number("How many different poses are fitted.", 1, 60)] = 10,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write. [default: subject in the recording's folder]")
    ] = None,
    seed: Seed = 0,
    threads: Threads = None,
) -> None:
    """Measure a person: lengths, girths and a body for `hypose track --subject`, from silhouettes or from a scan."""
    set_threads(threads)
    if (recording is None) == (mesh is None):
        raise InputError("Give either a recording's folder or --mesh with a scan.")
    if mesh is not None:
        _from_mesh(mesh, unit, height, out or mesh.with_name("subject"))
        return
    assert recording is not None
    from hypose.app.jobs.job import choose_frames
    from hypose.body.ready_bodies import human
    from hypose.io.files import claimed
    from hypose.io.recordings.frames import FrameStream
    from hypose.io.recordings.recording import load_recording
    from hypose.pipeline.run import check_views
    from hypose.pipeline.subject_from_motion import AnthropometryOptions, estimate_subject, save_subject
    from hypose.tracking.starts import KNOWN_POSES

    if start != "hull" and start not in KNOWN_POSES:
        raise InputError(f"There is no start {start!r}; the starts are hull, {', '.join(KNOWN_POSES)}.")
    loaded = choose_frames(load_recording(recording), frames)
    check_views(loaded)
    options = AnthropometryOptions(
        frames=poses,
        tracked=max(36, 3 * poses),
        height=height if height is not None else loaded.subject_height,
        mass=mass if mass is not None else loaded.subject_mass,
        poses=KNOWN_POSES if start == "hull" else (start,),
        seed=seed,
    )
    folder = out or loaded.folder / "subject"
    with claimed(folder), Stages() as progress:
        progress("background", 0, 1)
        with FrameStream(loaded) as source:
            progress("background", 1, 1)
            found = estimate_subject(
                source.frame,
                len(source),
                loaded.frame_rate,
                human(),
                options,
                progress=lambda done, total: progress("subject", done, total),
            )
            body, toml = save_subject(folder, found, human(), loaded.name)
            picture = _picture(folder / "subject.png", loaded, source, found)
    for text in (*loaded.notes, *source.notes, *found.notes):
        note(f"note: {text}")
    sizes = found.sizes.in_cm
    say(f"Stature {sizes['stature']:.1f} cm, shoulder height {sizes['shoulder height']:.1f} cm; all sizes: {toml}")
    say(f"Picture: {picture}")
    say(f"Track with: hypose track {recording} --subject {body.parent}")


def _from_mesh(mesh: Path, unit: str, height: float | None, folder: Path) -> None:
    from hypose.io.files import claimed
    from hypose.pipeline.mesh_subject import subject_from_mesh

    with claimed(folder):
        made = subject_from_mesh(mesh, folder, unit=unit, height=height)
    for text in made.notes:
        note(f"note: {text}")
    say(f"Body: {folder / 'body.npz'}")


def _picture(path: Path, recording: Recording, source: object, found: SubjectEstimate) -> Path:
    """Two fitted frames, each above with the template as tracked and below with the fitted body, in every view."""
    import numpy as np

    from hypose.app.jobs.checking import write_image
    from hypose.app.reports.result_pictures import Drawing, draw_all, layout, open_images
    from hypose.io.recordings.frames import FrameStream

    assert isinstance(source, FrameStream)
    images = open_images(recording)
    plan = layout([v.size for v in images])
    rows = []
    for k in sorted({0, len(found.frames) // 2}):
        frame = source.frame(found.frames[k])
        number = recording.frames[found.frames[k]]
        pictures = [v.read(number) for v in images]
        for body, poses, iou, what in (
            (found.template, found.template_poses, found.iou_before, "before"),
            (found.body, found.poses, found.iou, "after"),
        ):
            title = f"frame {number}, {what}: mean IoU {float(np.nanmean(iou[k])):.3f}"
            drawing = Drawing(body.skin(poses[k], body.fine), body.joints(poses[k]), frame.silhouettes, title)
            rows.append(draw_all(pictures, recording, plan, body, drawing))
    for v in images:
        v.close()
    sheet = np.concatenate(rows)
    write_image(path, sheet)
    return path
