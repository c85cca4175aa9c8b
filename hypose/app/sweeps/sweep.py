"""A sweep: recordings times sets of parameters, read from a TOML file, as tasks that know who they are.

A task's key is the hash of everything that decides its motion: settings, seed, versions, and the content of its inputs.
Equal keys give equal bytes, so a task whose results folder is complete needs no second run, on whatever machine.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from hypose.app.commands.console import ProgressCall, ignore
from hypose.app.jobs.job import Job, choose_frames, record_of
from hypose.app.jobs.truth import compare_with
from hypose.errors import HyposeError, InputError
from hypose.io.file_names import file_name
from hypose.io.files import read_toml
from hypose.io.motions.export import FORMATS
from hypose.io.motions.results import ResultsFolder, identity, to_json
from hypose.io.recordings.pose2sim import is_project
from hypose.io.recordings.recording import check_keys, load_recording
from hypose.pipeline.chunked import chunk_ranges
from hypose.pipeline.run import TrackOptions

_SWEEP_KEYS: dict[str, type | tuple[type, ...]] = {
    "recordings": list,
    "results": str,
    "formats": list,
    "overlay": bool,
    "retries": int,
    "chunk_s": (int, float),
    "settings": dict,
    "set": list,
    "slurm": dict,
}
_SETTING_KEYS: dict[str, type | tuple[type, ...]] = {
    "name": str,
    "recipe": str,
    "refine": bool,
    "evidence": str,
    "seed": int,
    "start": str,
    "height": (int, float),
    "subject": str,
    "frames": str,
}
MAX_TASKS = 100_000


@dataclass(frozen=True)
class Sweep:
    """recordings: paths; sets: one mapping of settings each, with its name; results: the folder; formats, overlay: what
    is written; retries: how often a task that failed by accident is begun again; slurm: options of the cluster;
    chunk_s: longer recordings are tracked in chunks of about so many seconds."""

    recordings: tuple[Path, ...]
    sets: tuple[Mapping[str, Any], ...]
    results: Path
    formats: tuple[str, ...] = ("trc", "csv")
    overlay: bool = False
    retries: int = 2
    slurm: Mapping[str, Any] = field(default_factory=dict)
    chunk_s: float | None = None


@dataclass(frozen=True)
class Task:
    """One recording tracked with one set. key: see the module; recording: its name, path its folder; settings: of the
    set; frames: how many; results: the folder; formats, overlay: what is written; chunk_s, chunks: into how many chunks
    of about how many seconds it is split (None, 0: it is not)."""

    key: str
    recording: str
    path: str
    set_name: str
    settings: Mapping[str, Any]
    frames: int
    results: str
    formats: tuple[str, ...]
    overlay: bool
    chunk_s: float | None = None
    chunks: int = 0

    @property
    def record(self) -> Path:
        """Where the finished task's figures lie."""
        return Path(self.results) / "task.json"

    def plain(self) -> dict[str, Any]:
        """Plain values that travel to a worker."""
        return asdict(self)


@dataclass(frozen=True)
class Refused:
    """A recording that cannot be loaded with a set, and why."""

    recording: str
    set_name: str
    reason: str


def read_sweep(path: Path) -> Sweep:
    """The sweep of a TOML file; an InputError names the file, the key and what is allowed."""
    if path.is_dir():
        raise InputError(
            f"{path} is a folder without a recording of its own; for all recordings in it write a file with the line "
            f'recordings = ["{path.name or "."}/*"] beside it, and give that (docs/batch.md).'
        )
    if not path.is_file():
        raise InputError(f"{path} does not exist; give a sweep file (TOML), see docs/batch.md.")
    table = read_toml(path)
    check_keys(str(path), table, _SWEEP_KEYS)
    formats = _texts(path, "formats", table.get("formats", ["trc", "csv"]))
    for name in formats:
        if name not in FORMATS:
            raise InputError(f"{path}: there is no export format {name!r}; the formats are {', '.join(FORMATS)}.")
    retries = table.get("retries", 2)
    if not 0 <= retries <= 20:
        raise InputError(f"{path}: retries = {retries} is not possible; give 0 to 20.")
    patterns = _texts(path, "recordings", table.get("recordings", []))
    recordings = _recordings(path, patterns)
    sets = tuple(_sets(path, table.get("settings", {}), table.get("set", [])))
    if len(recordings) * len(sets) > MAX_TASKS:
        raise InputError(
            f"{path}: {len(recordings)} recordings times {len(sets)} sets are more than {MAX_TASKS} tasks; split it."
        )
    results = path.parent / Path(table.get("results", f"{path.stem}-results")).expanduser()
    chunk_s = table.get("chunk_s")
    return Sweep(
        recordings, sets, results, formats, table.get("overlay", False), retries, table.get("slurm", {}), chunk_s
    )


def sweep_of(recording: Path) -> Sweep:
    """A single recording with the usual settings, its results in results/batch in its folder."""
    folder = recording if recording.is_dir() else recording.parent
    return Sweep((recording,), ({"name": "default"},), folder / "results" / "batch")


def is_recording(path: Path) -> bool:
    """True for a folder with a recording, or its recording.toml."""
    return path.name == "recording.toml" or (path / "recording.toml").is_file() or (path.is_dir() and is_project(path))


def _texts(path: Path, key: str, value: Sequence[Any]) -> tuple[str, ...]:
    if not all(isinstance(v, str) for v in value):
        raise InputError(f"{path}: {key} must be texts in [ ], got {value!r}; correct it.")
    return tuple(value)


def _recordings(path: Path, patterns: Sequence[str]) -> tuple[Path, ...]:
    """Recordings by name or wildcard, relative to the sweep's file; a wildcard passes over what is no recording."""
    found: dict[Path, None] = {}
    for pattern in patterns:
        full = Path(pattern).expanduser()
        if not any(c in pattern for c in "*?["):
            found[path.parent / full] = None
            continue
        base, parts = (Path(full.anchor), full.parts[1:]) if full.is_absolute() else (path.parent, full.parts)
        matches = sorted(base.glob("/".join(parts)))
        matches = [m for m in matches if m.is_dir() and is_recording(m)]
        if not matches:
            raise InputError(f"{path}: no recording matches {pattern!r}; a recording is a folder with recording.toml.")
        found |= dict.fromkeys(matches)
    if not found:
        raise InputError(f'{path}: there are no recordings; add recordings = ["FOLDER", "STUDY/*"].')
    return tuple(found)


def _sets(path: Path, common: Mapping[str, Any], tables: Sequence[Any]) -> Iterator[dict[str, Any]]:
    """Every combination of the values that are lists; names must differ."""
    names: set[str] = set()
    for n, table in enumerate(tables or [{"name": "default"}]):
        if not isinstance(table, dict):
            raise InputError(f"{path}: set must be [[set]] tables, got {table!r}; write [[set]] before each.")
        where = f"{path}, set {table.get('name', n + 1)}"
        merged = {**common, **table}
        merged.setdefault("name", f"set{n + 1}")
        lists = {k: v for k, v in merged.items() if isinstance(v, list)}
        for values in itertools.product(*lists.values()):
            chosen = dict(zip(lists, values, strict=True))
            one = {**merged, **chosen}
            check_keys(where, one, _SETTING_KEYS)
            one["name"] = "-".join([one["name"], *(f"{k}-{v}" for k, v in chosen.items())])
            if one["name"] in names:
                raise InputError(f"{path}: two sets are named {one['name']}; give each its name.")
            names.add(one["name"])
            if "subject" in one:
                one["subject"] = str(path.parent / Path(one["subject"]).expanduser())
            yield one


# ---- tasks ---------------------------------------------------------------------------------------------------


def plan(sweep: Sweep, progress: ProgressCall = ignore) -> tuple[list[Task], list[Refused]]:
    """The tasks in the order of the recordings, and what cannot be one. Two recordings with the same content and name
    are one task."""
    tasks: dict[str, Task] = {}
    refused: list[Refused] = []
    for n, path in enumerate(sweep.recordings):
        progress("plan", n, len(sweep.recordings))
        for chosen in sweep.sets:
            try:
                task = _task(sweep, path, chosen)
                tasks[task.key] = task
            except HyposeError as error:
                refused.append(Refused(path.name, chosen["name"], str(error)))
    progress("plan", len(sweep.recordings), len(sweep.recordings))
    return list(tasks.values()), refused


def _task(sweep: Sweep, path: Path, chosen: Mapping[str, Any]) -> Task:
    settings = {k: v for k, v in chosen.items() if k != "name"}
    # which recording it is decides where the results lie, so it is part of who the task is
    draft = Task("", path.name, str(path), chosen["name"], settings, 0, "", sweep.formats, sweep.overlay)
    job = job_of(draft)
    frames = len(job.recording.frames)
    chunks = len(chunk_ranges(frames, job.recording.frame_rate, sweep.chunk_s)) if sweep.chunk_s is not None else 1
    # key points alone are solved as one clip, and one camera finds nobody in the middle of it
    if chunks > 1 and not (job.options.whole_clip or job.options.of_picture):
        draft = replace(draft, chunk_s=sweep.chunk_s, chunks=chunks)
        job = replace(job, chunk_s=sweep.chunk_s)
    who = to_json({"recording": job.recording.name, **identity(record_of(job))})
    key = hashlib.sha256(who.encode()).hexdigest()[:16]
    folder = sweep.results / file_name(job.recording.name) / f"{file_name(chosen['name'])}-{key[:8]}"
    return replace(draft, key=key, recording=job.recording.name, frames=frames, results=str(folder))


def job_of(task: Task) -> Job:
    """The tracking job of a task, which goes on where an earlier one stopped."""
    settings = dict(task.settings)
    recording = choose_frames(load_recording(task.path), settings.pop("frames", None))
    settings.setdefault("height", recording.subject_height)
    truth = recording.folder / "truth.npz"
    return Job(
        recording,
        TrackOptions(**settings),
        ResultsFolder(Path(task.results)),
        formats=task.formats,
        overlay=task.overlay,
        resume=True,
        truth=compare_with(truth, recording.frames.start) if truth.is_file() else None,
        chunk_s=task.chunk_s,
    )
