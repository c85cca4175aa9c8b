"""`hypose export`, `report`, `explain`, `gait`, `compare` and `cite`: use results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from hypose import __version__
from hypose.app.commands.console import Stages, counted, each, print_note, print_notes, say
from hypose.body.motion import Motion
from hypose.errors import InputError
from hypose.io.files import check_writable, claimed, read_json
from hypose.io.motions.results import load_result_body
from hypose.options import MOST_FRAMES, MotionPath, Option, OutFolder, Threads, TrackedPath

if TYPE_CHECKING:
    from hypose.pipeline.gait import Gait


def export(
    results: TrackedPath,
    formats: Annotated[str, Option("Motion files to write; also osim, rrd.")] = "trc,c3d,bvh,glb,csv,mot",
    out: OutFolder = None,
) -> None:
    """Write motion files (TRC, C3D, BVH, GLB, CSV, MOT; OpenSim, Rerun) from a tracked motion."""
    from hypose.app.jobs.job import split_names
    from hypose.io.motions.export import export_motion

    motion, body = load_result_body(results)
    tell_untrusted(results)
    target = out or (results if results.is_dir() else results.parent)
    names = split_names(formats)
    with claimed(target), Stages() as progress:
        written = [p for name in each(progress, "export", names) for p in export_motion(motion, body, target, (name,))]
    for path in written:
        say(str(path))


def report(
    results: MotionPath,
    out: Annotated[Path | None, Option("File to write. [default: report.html in the results folder]")] = None,
    threads: Threads = None,
) -> None:
    """Write the report of a result again: one file that needs no other files."""
    from hypose.app.reports.report import write_report
    from hypose.app.studio.view_bundle import load_view

    folder = results if results.is_dir() else results.parent
    target = out or folder / "report.html"
    if target.is_dir():
        raise InputError(f"{target} is a folder; name the file to write, for example {target / 'report.html'}.")
    if results.exists():
        check_writable(target.parent)
    shown = load_view(results)
    with Stages() as progress:
        for path in each(progress, "report", [target]):
            write_report(path, shown)
    print_notes(shown.notes)
    say(f"Report: {target}")


def explain(
    results: TrackedPath,
    joint: Annotated[str, Option("Name of the joint, for example left_wrist.")],
    frame: Annotated[int, Option("Number of the frame in the recording.", 0, MOST_FRAMES)],
) -> None:
    """Explain where a joint of a frame comes from: its evidence, the passes that moved it, where else it may be."""
    from hypose.app.jobs.explain import explain_joint

    for line in explain_joint(results, joint, frame):
        say(line)


def gait(
    results: TrackedPath,
    out: OutFolder = None,
) -> None:
    """Write strikes, steps, cadence and speed (CSV, C3D with events), and joint angles over the gait cycle."""
    from hypose.pipeline.gait import gait_of

    motion, body = load_result_body(results)
    source = results if results.is_dir() else results.parent
    tell_untrusted(results)
    found = gait_of(motion, body)
    with claimed(out or source):
        written = _write_gait(out or source, motion, found)
    strikes = sum(e.kind == "strike" for e in found.events)
    off = counted(len(found.events) - strikes, "time")
    say(f"{counted(strikes, 'foot strike')}, {off} a foot left the ground, {counted(len(found.steps), 'step')}")
    for f in found.figures:
        say(f"{f.name.replace('_', ' ')}: {f.mean:.3f} {f.unit} ({f.low:.3f} to {f.high:.3f} with 90 %), n = {f.n}")
    if not found.steps:
        say("Nobody walks two steps in this motion, as far as the feet show.")
    for path in written:
        say(str(path))


def _write_gait(folder: Path, motion: Motion, gait: Gait) -> list[Path]:
    """Write the gait: events.csv, steps.csv, gait.csv and gait.c3d (joint centres with the events), and with a whole
    stride cycles.csv (joint angles over the cycle).

    motion: of which the gait is.
    Returns: paths of the files.
    """
    from hypose.app.reports.report_parts import write_csv
    from hypose.io.motions.marker_files import joint_residuals, write_c3d
    from hypose.pipeline.gait import PERCENT, angle_cycles

    start = float(motion.times[0])
    events = [
        (e.time, e.sd, e.side, e.kind, *e.place.tolist(), round((e.time - start) * motion.frame_rate))
        for e in gait.events
    ]
    steps = [
        (s.time, s.side, s.duration, s.duration_sd, s.length, s.length_sd, s.width, s.width_sd, s.double_support)
        for s in gait.steps
    ]
    figures = [(f.name, f.unit, f.mean, f.sd, f.low, f.high, f.n) for f in gait.figures]
    paths = [folder / n for n in ("events.csv", "steps.csv", "gait.csv", "gait.c3d")]
    write_csv(paths[0], "time_s sd_s side event x_m y_m z_m frame".split(), events)
    columns = "time_s side duration_s duration_sd_s length_m length_sd_m width_m width_sd_m double_support_s"
    write_csv(paths[1], columns.split(), steps)
    write_csv(paths[2], "name unit mean sd low_90 high_90 n".split(), figures)
    marks = [
        (e.time - start, e.side.capitalize(), {"strike": "Foot Strike", "off": "Foot Off"}[e.kind]) for e in gait.events
    ]
    names, residuals = motion.skeleton.joint_names, joint_residuals(motion)
    write_c3d(paths[3], names, motion.joints, motion.frame_rate, residuals, marks)
    cycles = angle_cycles(gait.events, motion)
    if not cycles:
        return paths
    paths.append(folder / "cycles.csv")
    header = [f"{c.name}_{what}" for c in cycles for what in ("mean_deg", "sd_deg", "uncertainty_deg")]
    table = np.column_stack([PERCENT, *(np.degrees(curve) for c in cycles for curve in (c.mean, c.sd, c.uncertainty))])
    write_csv(paths[-1], ["percent", *header], table.tolist())
    return paths


def cite(
    method: Annotated[
        str, Option("A results folder, or a recipe or method by name; a wrong one lists them.", argument=True)
    ] = "default",
    bibtex: Annotated[bool, Option("As BibTeX.")] = False,
) -> None:
    """Print the papers behind the method that gave a result."""
    for key in papers_of(method):
        kind, fields = PAPERS[key]
        if bibtex:
            values = {**fields, "title": f"{{{fields['title']}}}"}
            say(f"@{kind}{{{key},\n" + "".join(f"  {k} = {{{v}}},\n" for k, v in values.items()) + "}\n")
        else:
            *others, last = fields["author"].split(" and ")
            authors = f"{', '.join(others)} and {last}" if others else last
            say(f"{authors} ({fields['year']}). {fields['title']}. {', '.join([*fields.values()][3:])}.")


def tell_untrusted(results: Path) -> None:
    """Print a warning line if the assessment of a result (a folder, or its motion.npz) says that it is not to be
    trusted.

    Nothing is printed where the assessment is missing or unreadable.
    """
    from hypose.pipeline.assessment import UNTRUSTED, load_assessment

    folder = results if results.is_dir() else results.parent
    if (kept := load_assessment(folder)) is not None and kept.word == UNTRUSTED:
        print_note(f"note: {folder}: {kept.sentence}")


# ---- papers --------------------------------------------------------------------------------------------------


PAPERS: dict[str, tuple[str, dict[str, str]]] = {
    "hypose": (
        "software",
        {
            "author": "The hypose developers",
            "title": "hypose: human motion from ordinary cameras",
            "year": "2026",
            "version": f"version {__version__}",
        },
    ),
    "alcoverro2014": (
        "phdthesis",
        {
            "author": "Alcoverro, M.",
            "title": "Stochastic optimization and interactive machine learning for human motion analysis",
            "year": "2014",
            "school": "Universitat Politècnica de Catalunya",
        },
    ),
    "deutscher2005": (
        "article",
        {
            "author": "Deutscher, J. and Reid, I.",
            "title": "Articulated body motion capture by stochastic search",
            "year": "2005",
            "journal": "International Journal of Computer Vision",
            "volume": "61(2)",
            "pages": "185-205",
        },
    ),
    "isard1998": (
        "article",
        {
            "author": "Isard, M. and Blake, A.",
            "title": "CONDENSATION: conditional density propagation for visual tracking",
            "year": "1998",
            "journal": "International Journal of Computer Vision",
            "volume": "29(1)",
            "pages": "5-28",
        },
    ),
    "maccormick2000": (
        "inproceedings",
        {
            "author": "MacCormick, J. and Isard, M.",
            "title": "Partitioned sampling, articulated objects, and interface-quality hand tracking",
            "year": "2000",
            "booktitle": "European Conference on Computer Vision",
            "pages": "3-19",
        },
    ),
    "asteriadis2013": (
        "inproceedings",
        {
            "author": "Asteriadis, S. and Chatzitofis, A. and Zarpalas, D. and Alexiadis, D. S. and Daras, P.",
            "title": "Estimating human motion from multiple Kinect sensors",
            "year": "2013",
            "booktitle": "MIRAGE 2013, Berlin",
        },
    ),
    "sminchisescu2001": (
        "techreport",
        {
            "author": "Sminchisescu, C. and Triggs, B.",
            "title": "A robust multiple hypothesis approach to monocular human motion tracking",
            "year": "2001",
            "institution": "INRIA",
            "number": "Rapport de recherche 4208",
        },
    ),
    "saffari2009": (
        "inproceedings",
        {
            "author": "Saffari, A. and Leistner, C. and Santner, J. and Godec, M. and Bischof, H.",
            "title": "On-line random forests",
            "year": "2009",
            "booktitle": "ICCV Workshops",
            "pages": "1393-1400",
        },
    ),
}
"""Works by the key of their BibTeX entry: its kind and its fields, authors joined by " and "."""

_THESIS, _SWARM = ("alcoverro2014",), ("asteriadis2013",)
METHODS: dict[str, tuple[str, ...]] = {
    "default": _THESIS,
    "sir": ("isard1998",),
    "apf": ("deutscher2005",),
    "partitioned": ("maccormick2000",),
    **dict.fromkeys(("hpf", "hpf+", "hpf-apo", "dd-hpf", "dd-hpf+", "dd-hpf+5", "dd-hpf+rivals"), _THESIS),
    "subject": _THESIS,
    "monocular": ("sminchisescu2001",),
    **dict.fromkeys(("fusion-fit", "fusion-swarm", "fusion-published", "fusion-published-window"), _SWARM),
    "gesture": (*_THESIS, "saffari2009"),
}
"""Keys of the works behind each method, without hypose itself."""


def papers_of(name: str) -> tuple[str, ...]:
    """List the keys of the works to cite, hypose first.

    name: name of a method, or a results folder, whose provenance names the method.
    Raises: InputError lists the methods.
    """
    path, method = Path(name), name
    if name not in METHODS and (path.is_dir() or path.suffix == ".json"):
        path = path / "provenance.json" if path.is_dir() else path
        try:
            method = str(read_json(path, "a provenance.json")["recipe"])
        except (KeyError, TypeError) as error:
            raise InputError(
                f"{path} tells no method ({error}); give a folder that hypose track or fuse wrote, or a method's name."
            ) from None
    if method not in METHODS and not method.startswith("fusion-"):
        raise InputError(
            f"There is no method or results folder {name!r}; give a folder that hypose track or fuse wrote, or one of "
            f"{', '.join(METHODS)}."
        )
    return ("hypose", *METHODS.get(method, ()))  # other baselines are textbook filters
