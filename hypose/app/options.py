"""What the commands with many options take, each option declared once.

Command line, tables of `hypose batch` and the studio's jobs are made of these fields. Nothing here computes, so that
`hypose track --help` answers at once.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

from hypose.options import (
    HEIGHT,
    MOST_FRAMES,
    OUTPUT,
    RESEARCH,
    CalibrationFile,
    Formats,
    FrameSpan,
    ListenHost,
    Option,
    OscAddress,
    RecordingPath,
    Resume,
    Seconds,
    Seed,
    Threads,
    Yes,
    declared,
)
from hypose.pipeline.track_options import CompareOptions, TrackOptions

_REFINE, _BOARD, _PERSON, _RECORDED, _LIVE = "Refine", "Board", "From a person", "Recorded", "Live"


@dataclass(frozen=True, kw_only=True)
class TrackCommand(TrackOptions):
    """Track the person in a recording, or several: poses with uncertainty, motion files, overlay video, report.

    It ends with an assessment: good, look at some frames, or not to be trusted, and why; the last with exit code 3.
    """

    recording: RecordingPath
    frames: FrameSpan = None
    people: Annotated[
        str | None,
        Option(
            "Several people: all, how many at most, or the name of one in recording.toml. Results: a folder for each. "
            "[default: one]",
            value="WHO",
        ),
    ] = None
    camera: Annotated[str | None, Option("Only this camera of the recording.", value="NAME")] = None
    out: Annotated[Path | None, Option("Results folder. [default: results/RECIPE in the recording's folder]")] = None
    resume: Resume = False
    formats: Formats = "trc,c3d,bvh,glb,csv,mot,osim"
    overlay: Annotated[bool, Option("Do not write overlay.webm.", group=OUTPUT)] = True
    report: Annotated[bool, Option("Do not write report.html.", group=OUTPUT)] = True
    calibration: CalibrationFile = None
    yes: Yes = False
    threads: Threads = None
    floor: Annotated[
        float | None,
        Option("With one camera: height of the floor in the world.", -100, 100, unit="metres", group=RESEARCH),
    ] = None
    colours: Annotated[bool, Option("Ask the pictures where arms are, from silhouettes; slower.", group=RESEARCH)] = (
        False
    )

    @property
    def options(self) -> TrackOptions:
        """Options of tracking in this command, without those of files and output."""
        own = {"floor": self.floor, "colours": self.colours or None}
        chosen: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(TrackOptions)}
        chosen["own"] = {k: v for k, v in own.items() if v is not None}
        return TrackOptions(**chosen)


OF_RECORDING = {
    d.flag.removeprefix("--").removeprefix("no-"): d
    for d in declared(TrackCommand)
    if d.name not in ("recording", "frames", "out", "resume", "calibration", "yes", "threads")
}
"""Keys of the table [track] in recording.toml."""


def recorded_options(recording: Path) -> dict[str, Any]:
    """Read the options of `hypose track` that a recording keeps: the table [track] of its recording.toml.

    recording: the folder or the file; one that cannot be read has no options, and loading it says why.
    Returns: values by name of a field of `TrackCommand`.
    Raises: InputError names the key and the possible values.
    """
    from hypose.io.files import read_toml
    from hypose.io.recordings.recording import CHECKS, check_keys

    toml = recording if recording.suffix == ".toml" else recording / "recording.toml"
    table = read_toml(toml).get("track", {}) if toml.is_file() else {}
    if not isinstance(table, dict):
        return {}
    where = f"{toml}, track"
    check_keys(where, table, {k: CHECKS[d.kind] for k, d in OF_RECORDING.items()})
    out = {OF_RECORDING[k].name: OF_RECORDING[k].check(value, f"{where}: {k}") for k, value in table.items()}
    if "subject" in out:
        out["subject"] = str(toml.parent / out["subject"])
    return out


@dataclass(frozen=True, kw_only=True)
class SubjectCommand:
    """Measure a person: lengths, girths and a body for `hypose track --subject`, from silhouettes or from a scan."""

    recording: Annotated[
        Path | None, Option("A recording, as hypose track takes it; none with --mesh.", argument=True)
    ] = None
    mesh: Annotated[
        Path | None, Option("A scan of the person instead of a recording: obj, ply, stl, off, glb or npz.")
    ] = None
    unit: Annotated[str, Option("The scan's unit.", choices=("m", "cm", "mm", "in"))] = "m"
    height: Annotated[float | None, Option("The person's height in metres, when known.", 0.5, 2.5, unit="metres")] = (
        None
    )
    mass: Annotated[float | None, Option("The person's mass in kilograms, when known.", 8, 350, unit="kilograms")] = (
        None
    )
    start: Annotated[
        str, Option("The first frame's pose; hull: find out.", choices=("hull", "a", "t", "standing", "hands-up"))
    ] = "hull"
    frames: FrameSpan = None
    poses: Annotated[int, Option("How many different poses are fitted.", 1, 60)] = 10
    out: Annotated[Path | None, Option("Folder to write. [default: subject in the recording's folder]")] = None
    seed: Seed = 0
    threads: Threads = None


@dataclass(frozen=True, kw_only=True)
class CalibrateCommand:
    """Calibrate cameras: lenses and places from a board, from measured points, or from a person; or convert."""

    sources: Annotated[
        tuple[Path, ...],
        Option(
            "Board videos or photo folders, one per camera, or a folder that holds them; a recording for "
            "--from-person.",
            argument=True,
        ),
    ] = ()
    points: Annotated[Path | None, Option("Instead of a board: a TOML file of measured points and their clicks.")] = (
        None
    )
    convert: Annotated[Path | None, Option("Instead: a calibration file of another program.")] = None
    unit: Annotated[str, Option("Unit of the file given with --convert.", choices=("auto", "m", "cm", "mm"))] = "auto"
    out: Annotated[
        Path | None,
        Option(
            "File to write; its ending tells the format (see docs/calibration.md). [default: calibration.toml, of "
            "--from-person in the recording's folder]"
        ),
    ] = None
    intrinsics: Annotated[
        Path | None,
        Option("Calibration file whose lenses are kept, or a folder with board videos or photos for the lenses."),
    ] = None
    refine_lenses: Annotated[bool, Option("Refine the lenses of the --intrinsics file as well.")] = False
    fisheye: Annotated[bool, Option("The lenses are fisheyes.")] = False
    chessboard: Annotated[
        str | None,
        Option(
            "Inner corners of the chessboard, for example 9x6. [default: counted in the pictures]",
            value="NxN",
            group=_BOARD,
        ),
    ] = None
    charuco: Annotated[
        str | None, Option("Squares of the ChArUco board, for example 5x7.", value="NxN", group=_BOARD)
    ] = None
    square: Annotated[
        str | None,
        Option("Side of a square with its unit: 115mm, 4.5cm, 1in.", value="LENGTH", group=_BOARD),
    ] = None
    marker: Annotated[str | None, Option("Side of a ChArUco marker with its unit.", value="LENGTH", group=_BOARD)] = (
        None
    )
    dictionary: Annotated[str, Option("Markers of the ChArUco board.", value="NAME", group=_BOARD)] = "DICT_4X4_1000"
    inverted: Annotated[bool, Option("The board is printed white on black.", group=_BOARD)] = False
    legacy: Annotated[bool, Option("The ChArUco board was made with OpenCV before 4.6.", group=_BOARD)] = False
    floor: Annotated[
        int | None,
        Option(
            "Frame in which the board lies on the floor. [default: where it lies still]", 0, MOST_FRAMES, group=_BOARD
        ),
    ] = None
    lag: Annotated[
        tuple[str, ...],
        Option("Its video is so many frames late (may be repeated).", value="CAMERA=FRAMES", group=_BOARD),
    ] = ()
    frames: Annotated[int, Option("Pictures looked at per camera.", 1, 100_000, group=_BOARD)] = 120
    sheet: Annotated[Path | None, Option("Picture of what was seen. [default: beside --out, .png]", group=_BOARD)] = (
        None
    )
    from_person: Annotated[
        bool, Option("Instead of a board: by the person who walks about in a recording.", group=_PERSON)
    ] = False
    height: Annotated[
        float | None, Option("How tall that person is, in metres.", *HEIGHT, unit="metres", group=_PERSON)
    ] = None
    focal: Annotated[
        tuple[str, ...],
        Option(
            "Focal length in pixels of all cameras, or CAMERA=PIXELS of each (repeated). [default: found out]",
            value="PIXELS",
            group=_PERSON,
        ),
    ] = ()
    largest: Annotated[
        float | None,
        Option(
            "Videos start within so many seconds. [default: found out]",
            0,
            600,
            above=True,
            unit="seconds",
            group=_PERSON,
        ),
    ] = None
    yes: Yes = False


@dataclass(frozen=True, kw_only=True)
class CheckCommand:
    """Check whether the views agree, name the cause and the camera, and correct it with --refine.

    Exit code 0: fine, or refined; 1: something is wrong.
    """

    recording: RecordingPath
    out: Annotated[Path | None, Option("Contact sheet to write. [default: results/check.png there]")] = None
    samples: Annotated[int, Option("Frames whose common volume is looked at.", 1, 10_000)] = 5
    frames: Annotated[int, Option("Consecutive frames that the doctor looks at; 0: skip it.", 0, 100_000)] = 100
    calibration: CalibrationFile = None
    refine: Annotated[bool, Option("Find the cameras' poses from the moving person.", group=_REFINE)] = False
    using: Annotated[
        str,
        Option(
            "What of the person.",
            choices=("auto", "keypoints", "silhouettes"),
            flag="--from",
            group=_REFINE,
        ),
    ] = "auto"
    far: Annotated[bool, Option("Also cameras more than 10 degrees or 0.5 m off (--refine=far).", group=_REFINE)] = (
        False
    )
    focal: Annotated[bool, Option("Focal lengths too.", group=_REFINE)] = False
    keep: Annotated[
        tuple[str, ...], Option("Camera that stays as it is (may be repeated).", value="NAME", group=_REFINE)
    ] = ()
    height: Annotated[
        float | None, Option("The person's height: sets the scale.", *HEIGHT, unit="metres", group=_REFINE)
    ] = None
    to: Annotated[
        Path | None, Option("New calibration file. [default: results/calibration_refined.toml there]", group=_REFINE)
    ] = None


@dataclass(frozen=True, kw_only=True)
class SyncCommand:
    """Find how many frames each view is late. With --out, masks, depth maps and key points in step are written."""

    recording: RecordingPath
    by: Annotated[str, Option("What is seen or heard in all views.", choices=("motion", "sound", "flash"))] = "motion"
    offsets: Annotated[str | None, Option("Known offsets in frames instead, one per view.", value="0,-2.5,1")] = None
    largest: Annotated[
        float | None,
        Option("Largest offset in seconds. [default: as large as needed]", 0, 600, above=True, unit="seconds"),
    ] = None
    frames: Annotated[int, Option("Consecutive frames that motion is taken from.", 24, 100_000)] = 250
    out: Annotated[Path | None, Option("New folder for masks, depth maps and key points that are in step.")] = None


@dataclass(frozen=True, kw_only=True)
class FuseCommand:
    """Fuse the skeletons of several depth sensors: one skeleton per person with its uncertainty. See docs/fusion.md and
    docs/live.md.

    It ends with an assessment: good, worth a look, or not to be trusted, and why; the last with exit code 3.
    """

    recording: Annotated[
        Path | None,
        Option("Folder with session.json, a .csv, .skeleton or .jsonl file; nothing with --live.", argument=True),
    ] = None
    method: Annotated[
        str, Option("How.", choices=("fit", "swarm", "published", "published-window"), group=_RECORDED)
    ] = "fit"
    out: Annotated[Path | None, Option("Results folder. [default: results/fuse-METHOD beside it]", group=_RECORDED)] = (
        None
    )
    formats: Formats = "trc,c3d,csv"
    reference: Annotated[
        str | None,
        Option("Sensor that the others are registered to. [default: the first]", value="NAME", group=_RECORDED),
    ] = None
    up: Annotated[
        str,
        Option(
            "What is up: the person on average, or the sensor's y axis.",
            choices=("person", "sensor"),
            group=_RECORDED,
        ),
    ] = "person"
    seed: Seed = 0
    rate: Annotated[
        float | None, Option("Frames per second of the result. [default: the sensor's; live: 30]", 1, 1000)
    ] = None
    live: Annotated[bool, Option("Take skeletons from the network and send the fused ones.", group=_LIVE)] = False
    udp: Annotated[int | None, Option("UDP port for skeletons. [default: 9870]", 0, 65535, group=_LIVE)] = None
    ws: Annotated[
        int | None,
        Option("WebSocket port: /in takes skeletons, /out sends. [default: 9871]", 0, 65535, group=_LIVE),
    ] = None
    osc: OscAddress = None
    host: ListenHost = "127.0.0.1"
    token: Annotated[
        str | None, Option("What senders must show. [default: none on this computer, else made]", group=_LIVE)
    ] = None
    wait: Annotated[float, Option("Milliseconds that a frame waits for late sensors.", 0, 10_000, group=_LIVE)] = 5.0
    record: Annotated[Path | None, Option("New folder to record the skeletons to.", group=_LIVE)] = None
    threads: Threads = None


@dataclass(frozen=True, kw_only=True)
class CompareCommand(CompareOptions):
    """Compare results with markers or other motions: errors per joint and angle, one table, one page."""

    files: Annotated[
        tuple[Path, ...],
        Option(
            "RESULT OTHER [RESULT OTHER ...]: a results folder, then what to compare it with: .c3d, .trc, .mot, .sto "
            "or another result.",
            argument=True,
        ),
    ]
    joint: Annotated[
        tuple[str, ...],
        Option("The joint is the middle of these markers (may be repeated).", value="JOINT=MARKER+MARKER"),
    ] = ()
    subject: Annotated[
        str | None, Option("Whose points, where a file names several people's SUBJECT:POINT.", value="NAME")
    ] = None
    max_mm: Annotated[
        float | None,
        Option("Exit with 1 if the RMSE of the joints, offsets aside, is larger.", 0, 10_000, unit="millimetres"),
    ] = None
    max_degrees: Annotated[
        float | None, Option("Exit with 1 if an angle's RMSE, its offset aside, is larger.", 0, 360, unit="degrees")
    ] = None
    min_coverage: Annotated[
        float | None, Option("Exit with 1 if a smaller share lies in the 90 % regions (0.8, for example).", 0, 1)
    ] = None
    out: Annotated[
        Path | None, Option("Folder for compare.csv and compare.html. [default: the first results folder]")
    ] = None


@dataclass(frozen=True, kw_only=True)
class LiveCommand:
    """Follow people with calibrated cameras while it happens. See docs/cameras-live.md."""

    rig: Annotated[
        Path, Option("Calibration file, or a recording, whose videos are played without --source.", argument=True)
    ]
    source: Annotated[
        tuple[str, ...],
        Option(
            "Number of a device (0), http:// (motion JPEG), rtsp://, a video, a folder of pictures. Once for each "
            "camera.",
            value="CAMERA=WHERE",
        ),
    ] = ()
    rate: Annotated[
        float | None, Option("Pictures per second of the cameras. [default: 30, or the recording's]", 1, 240)
    ] = None
    countdown: Annotated[
        float, Option("Seconds in which to leave the view before the empty room is learnt.", 0, 600)
    ] = 5.0
    detector: Annotated[
        bool | None,
        Option(
            "Find people by hypose's detector: no person has to leave the view. [default: where a recording is played "
            "that shows no empty room]"
        ),
    ] = None
    people: Annotated[int, Option("Follow so many people at most.", 1, 8)] = 1
    height: Annotated[float | None, Option("How tall the person is, when known.", *HEIGHT, unit="metres")] = None
    subject: Annotated[
        Path | None, Option("The person's body, as hypose subject writes it; else it is fitted on the way.")
    ] = None
    seconds: Annotated[float, Option("Stop after so many seconds; 0 = never.", 0, 10**6)] = 0.0
    ws: Annotated[int, Option("WebSocket port on this computer: /out (JSON).", 0, 65535, group=OUTPUT)] = 9872
    udp: Annotated[str | None, Option("A JSON line per pose.", value="HOST:PORT", group=OUTPUT)] = None
    osc: OscAddress = None
    vmc: Annotated[str | None, Option("A program that moves an avatar (VMC).", value="HOST:PORT", group=OUTPUT)] = None
    record: Annotated[
        Path | None, Option("New folder for a recording that hypose track solves again.", group=OUTPUT)
    ] = None
    seed: Seed = 0
    threads: Threads = None


@dataclass(frozen=True, kw_only=True)
class SynthCommand:
    """Make a synthetic recording with known truth: videos, background clips, calibration, recording.toml, truth.npz."""

    folder: Annotated[Path, Option("Folder to write the recording to.", argument=True, value="OUT")]
    motion: Annotated[
        str, Option("walk, jog, box, wave, cross_arms, punch, sit_down, serve or combo.", value="NAME")
    ] = "walk"
    subject: Annotated[str, Option("Name or number of a subject. [default: chosen by the seed]", value="WHO")] = ""
    rig: Annotated[str, Option("humaneva-4, humaneva-7, ixmas-5, court-4 or ring-N.", value="NAME")] = "humaneva-4"
    sensors: Annotated[
        str,
        Option(
            "Depth cameras instead of a rig: depth-1 (in front), depth-2 (and beside), depth-3 (round).", value="NAME"
        ),
    ] = ""
    seconds: Seconds = 4.0
    frame_rate: Annotated[float, Option("Frames per second.", 1, 1000)] = 25.0
    corruption: Annotated[
        tuple[str, ...],
        Option("What goes wrong: table, desync, dead-camera, ... (may be repeated).", value="NAME"),
    ] = ()
    clothing: Annotated[float, Option("Thickness of the clothes in metres.", 0, 0.04, unit="metres")] = 0.02
    distorted: Annotated[bool, Option("Lenses without distortion.")] = True
    keypoints: Annotated[bool, Option("Write 2D key points (OpenPose JSON) as well.")] = False
    raw: Annotated[
        bool, Option("As it is filmed: videos of a board, the empty room and the person, to practise on.")
    ] = False
    seed: Seed = 0
    threads: Threads = None
