"""Define the studio's jobs: convert the page's options to the arguments of a hypose command, and find the next job of a
recording.

A job is the command itself in a process of its own, so the studio can do nothing that the command line cannot, and the
page can show the command. The command checks its options; here each one is only kept in one argument.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hypose.app import options
from hypose.app.commands import commands_recordings, commands_results
from hypose.app.jobs.correct import correct, read_correction
from hypose.app.studio.catalog import Catalog, Item, Kind, changed
from hypose.errors import HyposeError, InputError
from hypose.io.files import free_path, read_json, read_toml
from hypose.io.recordings.recording import Recording
from hypose.options import Declared, declared

CALIBRATION = "calibration.toml"
"""File of a recording for the calibration from clips of a board or from the person."""
IN_STEP = 0.5
"""Smallest difference between cameras that is corrected, frames; below it they show the same instant of a person who
walks.
"""


@dataclass(frozen=True)
class Plan:
    """Command of a job.

    arguments: arguments of the command `hypose`.
    title: for the page.
    recording, result: ids; the result may not exist yet.
    resumable: whether the same command with --resume continues an unfinished job.
    folder: folder in which an unfinished motion keeps its state; None: there is none.
    makes: id of the recording that the job makes; None: it makes none.
    """

    arguments: tuple[str, ...]
    title: str
    recording: str | None = None
    result: str | None = None
    resumable: bool = False
    folder: Path | None = None
    makes: str | None = None


_KINDS: Mapping[str, tuple[str, str, Callable[..., Any], str]] = {
    "calibrate": (
        "Calibrate the cameras of {}",
        "calibrate {} --from-person",
        options.CalibrateCommand,
        "chessboard charuco square marker dictionary inverted fisheye floor height yes",
    ),
    "sync": ("How late are the cameras of {}?", "sync {}", options.SyncCommand, "by largest frames"),
    "in_step": ("Synchronise {}", "sync {}", options.SyncCommand, "offsets"),
    "check": ("Check {}", "check {}", options.CheckCommand, "samples frames"),
    "refine": ("Refine the calibration of {}", "check {} --refine", options.CheckCommand, "using far focal height"),
    "keypoints": ("Find the person in the videos of {}", "keypoints {}", commands_recordings.keypoints, "yes"),
    "silhouettes": ("Silhouettes of {}", "silhouettes {}", commands_recordings.silhouettes, "frames"),
    "subject": ("Measure the person in {}", "subject {}", options.SubjectCommand, "height mass start frames poses"),
    "track": (
        "Track {}",
        "track {}",
        options.TrackCommand,
        "recipe refine evidence start height frames seed formats camera subject overlay",
    ),
    "correct": ("Track {} again from frame {}", "correct {}", correct, "until"),
    "export": ("Export {}", "export {}", commands_results.export, "formats"),
    "demo": ("Make a demo recording and track it", "demo", commands_recordings.demo, "seconds seed"),
    "fuse": ("Fuse {}", "fuse {}", options.FuseCommand, ""),
}
"""Title of each kind, its command ({}: the path), the declaration of the options, and those which a page may set."""
JOB_KINDS = tuple(_KINDS)
_OWN = {"track": ("name",), "correct": ("start",)}
"""Values of a page that are no options of the command: the name of the result, the clicks to start from."""
_OF: Mapping[str, Kind] = {"export": "result", "correct": "result", "fuse": "skeletons"}
"""What a job works on, where that is no recording."""
_CLICKS = "clicks:"
"""Prefix of a start that is the name of saved clicks."""


def form_of(kind: str) -> tuple[Declared, ...]:
    """List the options of a job that a page may set, as its command declares them."""
    _, _, declares, names = _KINDS[kind]
    known = {option.name: option for option in declared(declares)}
    return tuple(known[name] for name in names.split())


def forms() -> dict[str, list[dict[str, Any]]]:
    """Return the options of every job that a page may set, as JSON values."""
    return {
        kind: [
            {"name": o.name, "kind": o.kind.__name__, "default": o.default, **asdict(o.option)} for o in form_of(kind)
        ]
        for kind in JOB_KINDS
    }


def _arguments(kind: str, given: Mapping[str, Any]) -> list[str]:
    """Convert options to arguments, each with its value included, so that none can be read as another option or file.

    kind: kind of the job.
    given: values of the page by the options' names.
    """
    out = []
    for option in form_of(kind):
        value = given.get(option.name)
        if value is None or (option.kind is bool and value == option.default):
            continue
        bare = option.kind is bool and isinstance(value, bool)
        out.append(option.flag if bare else f"{option.flag}={_word(option.name, value)}")
    return out


def _word(name: str, value: Any) -> str:
    """Convert a value of an option to the text of its argument.

    name: name of the option, for the message.
    Raises: InputError where the value is no number, printable text without "/", or list of these.
    """
    if isinstance(value, list) and value:
        return ",".join(_word(name, v) for v in value)
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= 1e9:  # NaN is not
        return str(int(value)) if value == int(value) else repr(value)
    if not isinstance(value, str) or not value or len(value) > 200 or not value.isprintable() or "/" in value:
        raise InputError(f"The option {name} is not usable: {str(value)[:40]!r}.")
    return value


def plan_job(kind: str, request: Mapping[str, Any], catalog: Catalog) -> Plan:
    """Plan the command of a job that the page requests.

    kind: one of JOB_KINDS.
    request: {"recording", "result" or "skeletons": id, "options": {...}}.
    catalog: catalog of the served folder.
    Raises: InputError for an unknown kind or option; NotFound for an unknown id.
    """
    if kind not in JOB_KINDS:
        raise InputError(f"There is no job {str(kind)[:40]!r}; the jobs are {', '.join(JOB_KINDS)}.")
    title, words, known = *_KINDS[kind][:2], [*(o.name for o in form_of(kind)), *_OWN.get(kind, ())]
    given = request.get("options") or {}
    if not isinstance(given, dict):
        raise InputError("A job's options must be an object.")
    unknown = [str(o)[:40] for o in given if o not in known]
    if unknown:
        raise InputError(f"The job {kind} has no option {unknown[0]!r}; it has {', '.join(known)}.")
    arguments = () if kind in _OWN else _arguments(kind, given)
    if kind == "demo":
        out = free_path(catalog.root, "demo")
        result = catalog.id_of("result", out / "results" / "default")
        return Plan(("demo", "--out", str(out), *arguments), title, catalog.id_of("recording", out), result)
    of = _OF.get(kind, "recording")
    item = catalog.find(of, request.get(of))
    name, makes = item.path.name, None
    command = (*(str(item.path) if word == "{}" else word for word in words.split()), *arguments)
    if kind == "export":
        return Plan(command, title.format(name), None, item.id)
    if kind == "fuse":
        out = _inside(catalog, item, fused_in(item.path))
        return Plan((*command, "--out", str(out)), title.format(name), None, catalog.id_of("result", out))
    if kind == "correct":
        return _correct(item, given, catalog)
    for folder in ("results", "results/silhouettes", "subject"):
        _inside(catalog, item, item.path / folder)
    if kind == "track":
        return _track(item, given, title.format(name), catalog)
    boards = [str(p) for p in board_files(item.path) if catalog.contains(p)]
    if kind == "calibrate" and boards:
        sheet = item.path / "results" / "calibration.png"
        made = ("--out", str(item.path / CALIBRATION), "--sheet", str(sheet))
        command = ("calibrate", *boards, *arguments, *made)
    elif kind == "in_step":
        if "offsets" not in given:
            raise InputError("Say by how many frames each view is late.")
        out = _inside(catalog, item, free_path(item.path.parent, f"{name}-in-step"))
        command, makes = (*command, "--out", str(out)), catalog.id_of("recording", out)
    return Plan(command, title.format(name), item.id, resumable=kind == "keypoints", makes=makes)


def _inside(catalog: Catalog, item: Item, out: Path) -> Path:
    """Return an output folder after checking that no link leads it out of the served folder.

    item: to which it belongs, for the message.
    out: the folder, which need not exist.
    """
    if not catalog.contains(out):
        raise InputError(f"The results of {item.path.name} lie outside the served folder; use the command line.")
    return out


def fused_in(skeletons: Path) -> Path:
    """Return the folder into which a recording of live sensors is fused."""
    return skeletons / "results" / "fuse-fit"


def next_step(
    folder: Path, recording: Recording, after: str = "", anyway: bool = False
) -> tuple[str, dict[str, Any]] | None:
    """Find the next job on the way from the videos of a recording to a motion.

    folder, recording: folder of the recording, and the loaded recording.
    after: kind of the job that has just ended, which is not tried again.
    anyway: continue whatever the check found.
    Returns: kind and options; None where the user must act (a board, a finding to correct), or where the motion
        exists.
    """
    views = recording.views
    if uncalibrated(folder):
        person = len(views) > 1 and recording.subject_height is not None and not board_files(folder)
        return ("calibrate", {"yes": True}) if person and after != "calibrate" else None
    if len(views) > 1:
        bare = all(set(v.files) == {"video"} for v in views)
        if bare and after != "keypoints":
            return "keypoints", {"yes": True}
        late = found_offsets(folder, [v.name for v in views])
        if late is None and after != "sync":
            return "sync", {}
        if late is not None and max(late) - min(late) >= IN_STEP:
            return "in_step", {"offsets": late}
    check = read_found(folder, "check.json")
    if check is None or check["stale"]:
        return ("check", {}) if after != "check" else None
    named = zip(views, recording.rig.names, strict=True)
    masked = {name for v, camera in named if "masks" in v.files for name in (v.name, camera)}
    if after == "track" or (not anyway and any(_waits_for_user(f, masked) for f in check.get("findings", []))):
        return None
    detected = any("keypoints" in v.files for v in views)
    subject = (folder / "subject" / "subject.toml").is_file()
    return "track", {"evidence": "both" if detected else "silhouettes", "subject": subject}


def _waits_for_user(finding: Mapping[str, Any], masked: Set[str]) -> bool:
    """Return whether a finding is a fault that a button of the page corrects.

    masked: views with given masks, which do not move with their pictures.
    """
    cure = str(finding.get("cure"))
    moves = "set image_shift" in cure and masked.isdisjoint(finding.get("views", []))
    button = moves or "--refine" in cure or "set keypoint_" in cure or finding.get("kind") == "size"
    return bool(finding.get("fault")) and not finding.get("done") and button


def uncalibrated(folder: Path) -> bool:
    """Return whether the cameras of a recording are not calibrated yet and are found from a board or the person."""
    return not (folder / CALIBRATION).is_file() and described(folder).get("calibration") == CALIBRATION


def described(folder: Path) -> dict[str, Any]:
    """Read the values of folder/recording.toml; empty where it is missing or invalid."""
    with contextlib.suppress(HyposeError):
        return read_toml(folder / "recording.toml")
    return {}


def found_offsets(folder: Path, names: Sequence[str]) -> list[float] | None:
    """Read how late `hypose sync` found each view to be.

    folder: folder of the recording.
    names: names of its C views, in their order.
    Returns: (C,) frames, relative to the median view, so that few frames are lost; 0 where the lag is less than its
        error. None where it has not been found for these views.
    """
    found = read_found(folder, "sync.json") or {}
    views = found.get("views", [])
    if [v["name"] for v in views] != list(names):
        return None
    middle = sorted(v["late"] for v in views)[len(views) // 2]
    out = []
    for view in views:
        late, how = view["late"] - middle, view["how"]
        sd = re.match(r"sd ([\d.]+)", how)
        unknown = how.startswith("no motion") or (sd is not None and abs(late) <= 2 * float(sd[1]))
        out.append(0.0 if unknown else round(late, 2))
    return out


def read_found(folder: Path, name: str) -> dict[str, Any] | None:
    """Read the JSON object that `hypose check` or `hypose sync` last wrote to results/`name`, with whether the
    recording was changed since (`stale`); None where there is none.
    """
    path = folder / "results" / name
    with contextlib.suppress(InputError, OSError):
        value = read_json(path, "what a command found")
        stale = (changed(folder / "recording.toml") or 0.0) > (changed(path) or 0.0)
        return {**value, "stale": stale or value.get("stale") is True} if isinstance(value, dict) else None
    return None


def board_files(folder: Path) -> list[Path]:
    """List the clips or photo folders of the board, one per camera, that folder/recording.toml names.

    Returns: paths, made absolute from the folder; empty where recording.toml is missing, invalid, or names none.
    """
    views = described(folder).get("view", [])
    return [folder / v["board"] for v in views if isinstance(v, dict) and isinstance(v.get("board"), str)]


def _track(item: Item, given: Mapping[str, Any], title: str, catalog: Catalog) -> Plan:
    """Plan `hypose track` of a recording, into a new folder, so that no older result is overwritten.

    item: the recording.
    given: options of the page; its name, or that of its recipe, is the folder's, with a number where that exists; its
        start may be the name of saved clicks, its subject is True or False.
    title: for the page.
    """
    name = given.get("name") or given.get("recipe") or "default"
    if not isinstance(name, str) or not is_name(name):
        raise InputError(f"{str(name)[:40]!r} is no name for a result; use letters, digits, -, _ and dots between.")
    out = _inside(catalog, item, free_path(item.path / "results", name))
    paths = ["--out", str(out)]
    if isinstance(start := given.get("start"), str) and start.startswith(_CLICKS):
        paths += ["--start", str(saved_clicks(item.path, start.removeprefix(_CLICKS)))]
        given = {**given, "start": None}
    if given.get("subject") is True:
        paths += ["--subject", str(item.path / "subject")]
    command = ("track", str(item.path), *_arguments("track", {**given, "subject": None}), *paths)
    title += "" if out.name == "default" else f" as {out.name}"
    return Plan(command, title, item.id, catalog.id_of("result", out), True, out)


def _correct(item: Item, given: Mapping[str, Any], catalog: Catalog) -> Plan:
    """Plan `hypose correct` of a result.

    item: the result.
    given: options of the page; its start is the name of saved clicks.
    Raises: InputError where the clicks are missing, or the result is in no recording's folder.
    """
    folder, start = catalog.recording_of(item.path), given.get("start")
    if folder is None or not isinstance(start, str) or not start.startswith(_CLICKS):
        raise InputError("Say which clicks the result is to be tracked again from.")
    clicks = saved_clicks(folder, start.removeprefix(_CLICKS))
    original = re.sub(r"-corrected(-\d+)?$", "", item.path.name)
    out = free_path(item.path.parent, f"{original}-corrected")
    title = _KINDS["correct"][0].format(item.path.name, read_correction(clicks).frame)
    command = ("correct", str(item.path), str(clicks), *_arguments("correct", given), "--out", str(out))
    return Plan(command, title, catalog.id_of("recording", folder), catalog.id_of("result", out))


def saved_clicks(folder: Path, name: str) -> Path:
    """Return the file of clicks that the page saved under a name.

    folder: folder of the recording.
    Raises: InputError where there are none.
    """
    path = folder / "starts" / f"{name}.json"
    if not is_name(name) or not path.is_file():
        raise InputError(f"There are no clicks saved as {name[:40]!r} in {folder.name}; save them first.")
    return path


def is_name(text: str) -> bool:
    """Return whether a text is a safe name of a folder or file on any system."""
    return re.fullmatch(r"[A-Za-z0-9_](?:[A-Za-z0-9_.-]{0,78}[A-Za-z0-9_-])?", text) is not None
