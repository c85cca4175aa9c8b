"""`hypose track`, `demo`, `correct`, `subject` and `warm-up`."""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import click
from click.exceptions import Exit

from hypose.app.commands.console import Stages, print_note, say
from hypose.errors import InputError
from hypose.options import (
    HEIGHT,
    MOST_FRAMES,
    CalibrationFile,
    FrameRange,
    Option,
    RecordingPath,
    Resume,
    Seconds,
    Seed,
    Threads,
    Yes,
)

if TYPE_CHECKING:
    from hypose.app.jobs.job import Outcome, TrackJob
    from hypose.evidence.detector import PoseDetector
    from hypose.io.keypoints.read_keypoints import DetectedKeypoints
    from hypose.io.recordings.recording import Recording
    from hypose.pipeline.assessment import Assessment
    from hypose.pipeline.subject_from_motion import SubjectEstimate


def track(
    recording: RecordingPath,
    recipe: Annotated[str, Option("default, hpf, apf, sir, partitioned, or with one camera monocular.")] = "default",
    refine: Annotated[bool, Option("Contour refinement after a published recipe.")] = False,
    evidence: Annotated[
        str | None,
        Option(
            "silhouettes, keypoints or both; with monocular also auto or edges. [default: silhouettes; without "
            "pictures keypoints; both by a detector where nothing tells the person; with monocular all there is]"
        ),
    ] = None,
    start: Annotated[
        str,
        Option(
            "auto, keypoints, hull, or the first frame's pose: a, t, standing, hands-up; with one camera "
            "keypoints or a file of clicked joints."
        ),
    ] = "auto",
    height: Annotated[
        float | None,
        Option("The subject's height in metres. [default: recording.toml's, else estimated]", *HEIGHT, unit="metres"),
    ] = None,
    subject: Annotated[
        Path | None, Option("The person's body: the folder or body.npz that hypose subject wrote.")
    ] = None,
    people: Annotated[
        str | None,
        Option(
            "Several people: all, how many at most, or the name of one in recording.toml. Results: a folder for "
            "each. [default: one]"
        ),
    ] = None,
    no_smooth: Annotated[
        bool, Option("Each frame as it was tracked, without solving all together at the end.")
    ] = False,
    seed: Seed = 0,
    frames: FrameRange = None,
    out: Annotated[Path | None, Option("Results folder. [default: results/RECIPE in the recording's folder]")] = None,
    formats: Annotated[str, Option("Motion files to write.")] = "trc,c3d,bvh,glb,csv,mot,osim",
    no_overlay: Annotated[bool, Option("Do not write overlay.mp4.")] = False,
    no_report: Annotated[bool, Option("Do not write report.html.")] = False,
    resume: Resume = False,
    threads: Threads = None,
    calibration: CalibrationFile = None,
    camera: Annotated[str | None, Option("Only this camera of the recording, for monocular.")] = None,
    hypotheses: Annotated[
        int | None, Option("How many hypotheses are followed. [default: the recipe's own number]", 1, 100_000)
    ] = None,
    colours: Annotated[bool, Option("Ask the pictures where arms are, from silhouettes; slower.")] = False,
    floor: Annotated[
        float | None,
        Option("With monocular: height of the floor in the world, in metres.", -100, 100, unit="metres"),
    ] = None,
    yes: Yes = False,
) -> None:
    """Track the person in a recording, or several: poses with uncertainty, motion files, overlay video, report.

    It ends with an assessment: good, look at some frames, or not to be trusted, and why; the last with exit code 3.
    """
    set_threads(threads)
    from hypose.app.jobs.job import TrackJob, choose_frames, people_results
    from hypose.io.motions.results import ResultsFolder
    from hypose.io.recordings.recording import load_recording
    from hypose.pipeline.detect_keypoints import wants_detector
    from hypose.pipeline.one_camera import one_view
    from hypose.pipeline.track_options import TrackOptions

    loaded = choose_frames(load_recording(recording, calibration), frames)
    options = TrackOptions(
        recipe=recipe,
        refine=refine,
        evidence=evidence,
        seed=seed,
        start=start,
        height=height if height is not None else loaded.subject_height,
        subject=str(subject) if subject is not None else None,
        smooth=not no_smooth,
        particles=hypotheses,
        own=({} if floor is None else {"floor": floor}) | ({"colours": True} if colours else {}),
    )
    if camera is not None or options.of_picture:
        loaded = one_view(loaded, camera)
    elif evidence != "silhouettes" and (loaded.detected or wants_detector(loaded)):
        if not loaded.detected:
            print_note(
                "note: neither key points, masks nor pictures of the empty room are given: the detector finds people."
            )
        detected(loaded, loaded.frames, yes=yes, why="Tracking videos alone")
        loaded = choose_frames(load_recording(recording, calibration), frames)
    options = options.suited_to(loaded)
    results = ResultsFolder(out) if out is not None else ResultsFolder.of(loaded.folder, options.recipe)
    if people is not None and out is None:
        results = people_results(loaded.folder, options.recipe)
    job = TrackJob(
        loaded,
        options,
        results,
        formats=split_names(formats),
        overlay=not no_overlay,
        report=not no_report,
        resume=resume,
        run={"threads": threads},
        people=people,
    )
    report_outcome(job, run_shown(job, list(click.get_current_context().find_root().obj or [])))


def demo(
    out: Annotated[Path, Option("Folder to write to.")] = Path("demo"),
    seconds: Seconds = 4.0,
    seed: Seed = 1,
    threads: Threads = None,
) -> None:
    """Make a synthetic four-camera recording, track it as `hypose track` would, and compare with the truth."""
    set_threads(threads)
    from hypose.app.jobs.job import TrackJob
    from hypose.io.files import claimed
    from hypose.io.motions.results import ResultsFolder
    from hypose.io.recordings.recording import load_recording
    from hypose.pipeline.comparison import compare_with
    from hypose.pipeline.track_options import TrackOptions
    from hypose.synthetic.scenes import make_scene
    from hypose.synthetic.write_recording import check_folder, write_scene

    check_folder(out)
    say(f"Writing a synthetic recording of {seconds:g} s of walking, seen by four cameras, to {out}")
    scene = make_scene("walk", rig="humaneva-4", seconds=seconds, seed=seed, distorted=True)
    with claimed(out), Stages() as progress:
        write_scene(scene, out, progress=lambda done, total: progress("render", done, total))
    say(f"Tracking it as `hypose track {shlex.quote(str(out))}` would")
    recording = load_recording(out)
    results = ResultsFolder.of(recording.folder, "default")
    job = TrackJob(recording, TrackOptions(), results, run={"threads": threads}, truth=compare_with(out / "truth.npz"))
    report_outcome(job, run_shown(job, list(click.get_current_context().find_root().obj or [])))


def run_shown(job: TrackJob, arguments: list[str]) -> tuple[Outcome, dict[str, float]]:
    """Run a job with progress; when it is interrupted, say what was kept and how to go on, and exit with code 130."""
    from hypose.app.jobs.job import run_job
    from hypose.app.jobs.people_job import run_people
    from hypose.io.files import claimed

    with stopping(lambda: _kept(job, arguments)), claimed(job.results.path), Stages() as progress:
        if job.people is not None:
            outcome = run_people(job, job.people, progress)
        else:
            outcome = run_job(job, progress, progress.seconds)
        if not outcome.complete:
            raise KeyboardInterrupt
    return outcome, progress.seconds


@contextlib.contextmanager
def stopping(text: str | Callable[[], str] = "") -> Iterator[None]:
    """Within the block Ctrl-C, and SIGTERM likewise, end the command in order, with exit code 130.

    text: the sentence printed then."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    except KeyboardInterrupt:
        if text:
            say(text if isinstance(text, str) else text())
        raise Exit(130) from None
    finally:
        signal.signal(signal.SIGTERM, previous)


def _kept(job: TrackJob, arguments: list[str]) -> str:
    """What an interrupted run has kept, and how to go on."""
    from hypose.io.motions.results import load_motion

    results, total = job.results, len(job.recording.frames)
    again = [a for a in arguments if a != "--resume"]
    command = f"hypose {shlex.join([*again, '--resume'])}" if again[:1] == ["track"] else "the same command"
    if results.checkpoint.exists():
        done = f"{len(load_motion(results.motion))} of {total} frames" if results.motion.exists() else "tracked frames"
        return f"Stopped. Kept: {done} in {results.motion}, and the state of the tracker. Go on with: {command}"
    if results.motion.exists():
        return f"Stopped. The motion is complete in {results.motion}. Write the other files with: {command}"
    return f"Stopped before the first frame was tracked, so nothing was kept. Start again with: {command}"


def report_outcome(job: TrackJob, finished: tuple[Outcome, dict[str, float]]) -> None:
    """The closing lines."""
    from hypose.app.reports.summary import require_found, summarize

    outcome, seconds = finished
    s = summarize(outcome.motion)
    for text in outcome.notes:
        print_note(f"note: {text}")
    views, reported = len(job.recording.rig), int(outcome.motion.n_views.max(initial=0))
    of = f"{reported} of {views}" if 0 < reported < views else f"{views}"  # as many as ever reported anything at once
    parts = [f"{s.frames} frames in {of} views", f"{s.lost} lost", f"{s.extrapolated} extrapolated"]
    if s.iou == s.iou:
        parts.append(f"mean IoU {s.iou:.3f}")
    if s.sd_mm == s.sd_mm:
        parts.append(f"median joint sd {s.sd_mm:.1f} mm")
    if seconds.get("track"):
        parts.append(f"{s.frames / seconds['track']:.1f} frames/s")
    say(f"{job.recording.name}: " + ", ".join(parts))
    if outcome.truth is not None:
        say(f"Mean joint error: {outcome.truth.mean_mm:.1f} mm over {len(outcome.truth.names)} joints", "bold")
    say(f"Results: {job.results.path}")
    if job.report:
        say(f"Report:  {job.results.file('report.html')}")
    require_found(outcome.motion, job.recording.name, job.results.path)
    if outcome.assessment is not None:
        print_assessments({"": outcome.assessment})


def print_assessments(assessments: Mapping[str, Assessment]) -> None:
    """The assessment on all people by their names (none of one person); exit code 3 when one is not to be trusted."""
    from hypose.pipeline.assessment import EXIT_UNTRUSTED, UNTRUSTED

    for name, assessment in assessments.items():
        say(f"Assessment{' on ' if name else ''}{name}: {assessment.sentence}", "bold")
    if any(assessment.word == UNTRUSTED for assessment in assessments.values()):
        raise Exit(EXIT_UNTRUSTED)


def split_names(text: str) -> tuple[str, ...]:
    """The names of a comma-separated list; an InputError when there is none."""
    names = tuple(dict.fromkeys(n.strip().lower().lstrip(".") for n in text.split(",") if n.strip()))
    if not names:
        raise InputError("The list of formats is empty; give at least one, for example --formats trc,c3d.")
    return names


def set_threads(count: int | None) -> None:
    """Limit the threads of everything that uses threads; call it before numpy and OpenCV are imported."""
    if count is None:
        return
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = str(count)
    import cv2

    cv2.setNumThreads(count)


def correct(
    results: Annotated[Path, Option("Results folder of hypose track.", argument=True)],
    clicks: Annotated[Path, Option("The corrected pose: starts/NAME.json, saved in hypose view.", argument=True)],
    until: Annotated[
        int | None, Option("Track again up to this frame of the recording. [default: to the end]", 1, MOST_FRAMES)
    ] = None,
    out: Annotated[Path | None, Option("Results folder. [default: RESULTS-corrected]")] = None,
    formats: Annotated[str, Option("Motion files to write.")] = "trc,c3d,bvh,glb,csv,mot",
    threads: Threads = None,
) -> None:
    """Track a result again from a frame whose pose was corrected; the frames before stay as they are."""
    set_threads(threads)
    from hypose.app.jobs.correct import corrected_motion as track_again
    from hypose.app.jobs.correct import read_correction
    from hypose.app.reports.summary import require_found
    from hypose.app.studio.view_bundle import find_recording
    from hypose.io.files import claimed
    from hypose.io.motions.results import ResultsFolder

    recording = find_recording(results)
    if recording is None:
        raise InputError(f"{results} lies in no recording; give the results folder inside the recording's folder.")
    folder = ResultsFolder(out or results.with_name(f"{results.name}-corrected"))
    correction = read_correction(clicks)
    with claimed(folder.path), Stages() as progress:
        names = tuple(split_names(formats))
        motion = track_again(
            recording, ResultsFolder(results), correction, folder, until=until, formats=names, progress=progress
        )
    say(f"Frames {correction.frame} and after tracked again, {int(motion.lost.sum())} of {len(motion)} frames lost.")
    say(f"Results: {folder.path}")
    require_found(motion, recording.name, folder.path)


def warm_up(threads: Threads = None) -> None:
    """Compile what tracking, fusing and live need, so that the first run of each begins at once; once per machine, and
    again after an update. Ends with a third of a second of a made-up person tracked, report and all."""
    set_threads(threads)
    from hypose.app.jobs.job import TrackJob, run_job
    from hypose.compute.compiled import VARIABLE, cache_folder
    from hypose.compute.warming import TRACKING_KERNELS, kept, warm_up
    from hypose.fusion.live import LiveFuser
    from hypose.io.motions.results import ResultsFolder
    from hypose.io.recordings.recording import load_recording
    from hypose.pipeline.track_options import TrackOptions
    from hypose.synthetic.scenes import make_scene
    from hypose.synthetic.write_recording import write_scene

    folder, parts = cache_folder(), (*TRACKING_KERNELS, "monocular", "depth")
    if folder is None:
        raise InputError(f"There is no place for what is compiled; name a folder with {VARIABLE}.")
    before = kept(*parts)
    with tempfile.TemporaryDirectory(prefix="hypose-warm-up-") as temporary, Stages() as progress:
        progress("compile", 0, 1)
        warm_up(*parts, load=False)
        LiveFuser()
        progress("compile", 1, 1)
        scene, place = make_scene("walk", rig="humaneva-4", seconds=0.32, seed=1), Path(temporary)
        write_scene(scene, place, progress=lambda done, total: progress("render", done, total))
        run_job(TrackJob(load_recording(place), TrackOptions(), ResultsFolder(place / "results")), progress)
    if not kept(*parts):
        raise InputError(
            f"What was compiled could not all be kept in {folder}; make space there, see that it can be written, or "
            f"name another folder with {VARIABLE}, and run this again."
        )
    say("All of it had been compiled." if before else f"Compiled; kept in {folder}")


def subject(
    recording: Annotated[
        Path | None, Option("Folder with recording.toml, that file, or a Pose2Sim project.", argument=True)
    ] = None,
    mesh: Annotated[
        Path | None, Option("A scan of the person instead of a recording: obj, ply, stl, off, glb or npz.")
    ] = None,
    unit: Annotated[str, Option("The scan's unit: m, cm, mm or in.")] = "m",
    height: Annotated[
        float | None, Option("The person's height in metres, when known.", 0.5, 2.5, unit="metres")
    ] = None,
    mass: Annotated[
        float | None, Option("The person's mass in kilograms, when known.", 8, 350, unit="kilograms")
    ] = None,
    start: Annotated[str, Option("The first frame's pose: hull (find out), a, t, standing, hands-up.")] = "hull",
    frames: Annotated[str | None, Option("first:stop, counted from 0. [default: all]")] = None,
    poses: Annotated[int, Option("How many different poses are fitted.", 1, 60)] = 10,
    out: Annotated[Path | None, Option("Folder to write. [default: subject in the recording's folder]")] = None,
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
    from hypose.body.default_body import human
    from hypose.io.files import claimed
    from hypose.io.recordings.frames import FrameStream
    from hypose.io.recordings.recording import load_recording
    from hypose.pipeline.subject_from_motion import AnthropometryOptions, estimate_subject, save_subject
    from hypose.pipeline.track_options import check_views
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
        print_note(f"note: {text}")
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
        print_note(f"note: {text}")
    say(f"Body: {folder / 'body.npz'}")


def _picture(path: Path, recording: Recording, source: object, found: SubjectEstimate) -> Path:
    """Two fitted frames, each above with the template as tracked and below with the fitted body, in every view."""
    import numpy as np

    from hypose.app.jobs.checking import write_image
    from hypose.app.reports.result_pictures import Drawing, draw_all, open_images, tile_layout
    from hypose.io.recordings.frames import FrameStream

    assert isinstance(source, FrameStream)
    images = open_images(recording)
    plan = tile_layout([v.size for v in images])
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


def detect(
    loaded: Recording, detector: PoseDetector, target: Path, frames: range | None, *, resume: bool
) -> DetectedKeypoints:
    """Detect in frames (None: all) with progress; interrupted it says how to go on, and exits with code 130."""
    from hypose.io.files import claimed
    from hypose.pipeline.detect_keypoints import detect_keypoints

    with contextlib.ExitStack() as stack:
        stack.enter_context(claimed(target))
        progress = stack.enter_context(Stages())
        kept = f"Stopped; the frames done until then are in {target}. Go on with the same command and --resume."
        with stopping(kept):
            return detect_keypoints(
                loaded,
                detector,
                target,
                resume=resume,
                frames=frames,
                progress=lambda done, total: progress("detect", done, total),
            )


def detected(loaded: Recording, frames: range, *, yes: bool, why: str) -> DetectedKeypoints:
    """Detect key points in frames of a recording and keep them in its folder; frames already detected are skipped.

    why: first words of the sentence on the missing input."""
    from hypose.io.keypoints.read_keypoints import KEYPOINT_FOLDER, load_detected

    target = loaded.folder / KEYPOINT_FOLDER
    network = open_network_asking(yes, why)
    before = load_detected(target)
    same = before is not None and dict(before.identity) == network.identity
    if before is not None and same and before.covers(frames):
        return before
    return detect(loaded, network, target, frames, resume=same)


def open_network_asking(yes: bool, why: str = "Finding people in pictures") -> PoseDetector:
    """The detector; its models are fetched when the user agrees. An InputError says what to install."""
    from hypose.io.keypoints.detectors import MEGABYTES, PACKAGE, fetch_models, have_models, models_folder, runtime
    from hypose.io.keypoints.detectors import open_network as opened

    runtime(why)
    if not have_models():
        what = f"the detector's models from the package {PACKAGE} (Apache 2.0, {MEGABYTES} MB) to {models_folder()}"
        if not yes:
            if not sys.stdin.isatty():
                raise InputError(f"{why} fetches {what}, once, by pip; run the command again with --yes to agree.")
            if not click.confirm(f"Fetch {what}?"):
                raise Exit(1)
        say(f"Fetching {what} ...")
        fetch_models()
    return opened()
