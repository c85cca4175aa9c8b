"""Compare results with other motions for `hypose compare`: a table, a page, and limits for a lab's own checks."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from click.exceptions import Exit

from hypose import __version__
from hypose.app.commands.commands_results import tell_untrusted
from hypose.app.commands.console import Stages, counted, each, print_notes, say
from hypose.app.options import CompareCommand
from hypose.app.reports.report_parts import html_list, html_table, number_text, page, write_csv
from hypose.body.default_body import JOINT_NAMES
from hypose.errors import InputError
from hypose.io.files import check_writable, write_text
from hypose.io.motions.results import load_result
from hypose.options import named_values
from hypose.pipeline.comparison import Agreement, Comparison, compare_motions, read_other
from hypose.pipeline.settings import SETTINGS

Compared = tuple[Path, Path, Comparison]
"""Files of a result and of another motion, and their comparison."""


def compare(c: CompareCommand) -> None:
    """Compare results with other motions, write table and page, and check limits (`hypose compare`).

    Raises: Exit with code 1 where a limit is exceeded.
    """
    if len(c.files) % 2:
        raise InputError("Give pairs: a result, what to compare it with, and so on; one of the files has no partner.")
    pairs = list(zip(c.files[::2], c.files[1::2], strict=True))
    folder = c.out or (c.files[0] if c.files[0].is_dir() else c.files[0].parent)
    joints = parse_joints(c.joint)
    check_writable(folder)
    with Stages() as progress:
        compared = [
            (a, b, compare_motions(load_result(a), read_other(b, joints, c.subject), c))
            for a, b in each(progress, "compare", pairs)
        ]
    failed = exceeded(compared, c.max_mm, c.max_degrees, c.min_coverage)
    write_comparison_table(folder / "compare.csv", compared)
    write_comparison_page(folder / "compare.html", compared, failed)
    for file in dict.fromkeys(c.files):
        tell_untrusted(file)
    for _, other, found in compared:
        print_notes(found.notes)
        if found.joints:
            say(f"{other}: {_of_joints(found)}")
        if found.angles:
            degrees = [a.rmse_left for a in found.angles if a.unit == "deg" and a.n]
            span = f"{min(degrees):.1f} to {max(degrees):.1f} degrees" if degrees else "-"
            say(f"{other}: {counted(len(degrees), 'angle')}, offsets aside: RMSE {span}")
    say(f"Table: {folder / 'compare.csv'}")
    say(f"Page:  {folder / 'compare.html'}")
    for text in failed:
        say(text, "yellow")
    if failed:
        raise Exit(1)


def _of_joints(found: Comparison) -> str:
    """Return how well the joints agree, in words."""
    (median, p95, rmse), share = found.left_mm, mean_coverage(found)
    inside = f", {100 * share:.0f} % inside our 90 % regions" if share == share else ""
    return (
        f"{counted(len(found.joints), 'joint')}, offsets aside: median {median:.1f} mm, 95 % within {p95:.1f} mm, "
        f"RMSE {rmse:.1f} mm{inside}"
    )


def exceeded(
    compared: Sequence[Compared], mm: float | None, degrees: float | None, coverage: float | None
) -> list[str]:
    """List a sentence for every limit that a comparison exceeds. A limit of None is not checked.

    mm: largest RMSE of all joints, mm, each without its constant offset.
    degrees: largest RMSE of an angle without its constant offset.
    coverage: least share inside our 90 % regions, mean over the joints.
    """
    out = []
    for _, other, found in compared:
        rmse = found.left_mm[2]
        if mm is not None and not rmse <= mm:
            out.append(f"{other}: the joints' RMSE is {rmse:.1f} mm, at most {mm:g} is allowed.")
        worst = max((a for a in found.angles if a.unit == "deg" and a.n), key=lambda a: a.rmse_left, default=None)
        if degrees is not None and (worst is None or worst.rmse_left > degrees):
            said = (
                "there are no angles" if worst is None else f"{worst.name} has an RMSE of {worst.rmse_left:.1f} degrees"
            )
            out.append(f"{other}: {said}, at most {degrees:g} are allowed.")
        share = mean_coverage(found)
        if coverage is not None and not share >= coverage:
            out.append(f"{other}: {100 * share:.0f} % lie in our 90 % regions, {100 * coverage:.0f} % are needed.")
    return out


def mean_coverage(found: Comparison) -> float:
    """Compute how often the other motion lies in our 90 % confidence regions: the share of the frames, mean over the
    joints.

    Returns: 0 to 1; NaN where our motion has no regions.
    """
    shares = [a.covered[SETTINGS.compare_levels.index(0.9)] for a in found.joints]
    known = [s for s in shares if np.isfinite(s)]
    return float(np.mean(known)) if known else float("nan")


def parse_joints(texts: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Parse the options JOINT=MARKER+MARKER to names of markers by joint.

    Raises: InputError for another form, an unknown joint, or one that is given twice.
    """
    form = f"JOINT=MARKER+MARKER, with one of the joints {', '.join(JOINT_NAMES)}"
    given = named_values("--joint", texts, form, JOINT_NAMES, r"\s*[^+\s].*")
    return {joint: tuple(m.strip() for m in names.split("+") if m.strip()) for joint, names in given.items()}


def write_comparison_table(path: Path, compared: Sequence[Compared]) -> None:
    """Write a table with one row per joint and angle of every pair."""
    header = "result other name unit frames median p95 rmse offset median_left p95_left rmse_left".split()
    header += [f"{k}_{a}" for k in ("bias", "low", "high", "r") for a in "xyz"]
    header += [f"covered_{100 * level:g}" for level in SETTINGS.compare_levels]
    rows = []
    for result, other, found in compared:
        for a in (*found.joints, *found.angles):
            row = [result, other, a.name, a.unit, a.n, *_distances(a)]
            for values in (a.bias, a.low, a.high, a.r):
                row += [*values.tolist(), *[None] * (3 - len(values))]
            rows.append([*row, *a.covered])
    write_csv(path, header, rows)


def _distances(a: Agreement) -> tuple[float, ...]:
    return a.median, a.p95, a.rmse, a.offset, a.median_left, a.p95_left, a.rmse_left


def write_comparison_page(path: Path, compared: Sequence[Compared], failed: Sequence[str]) -> None:
    """Write an HTML page that needs no other files.

    failed: sentences on exceeded limits.
    """
    e = html.escape
    parts = [
        "<h1>Comparison</h1>",
        *(f'<p class="bad">{e(f)}</p>' for f in failed),
    ]
    for result, other, f in compared:
        parts.append(f"<h2>{e(str(result))} against {e(str(other))}</h2>")
        if f.joints:
            parts.append(f"<p>{_of_joints(f)}. Offset in time: {f.offset:+.3f} s.</p>")
            parts += [_table(f.joints), _errors(f)]
        if f.angles:
            parts += ["<h3>Angles</h3>", _table(f.angles)]
        if f.notes:
            parts.append(html_list(f.notes))
    parts.append(
        "<p class='dim'>Median, 95th percentile and RMSE of the distance between the two (angles: of the absolute "
        "difference), as it is and without the constant offset of each joint in its segment, by which two programs "
        "define a joint differently. Bias and limits of agreement (mean &plusmn; 1.96 standard deviations, Bland and "
        "Altman 1986) of other minus ours, per axis. r: Pearson's correlation. Inside 90 %: share of frames in which "
        f"the other lies in our 90 % region.</p><p class='dim'>hypose {__version__}</p>"
    )
    write_text(path, page("Comparison", "\n".join(parts)))


def _table(rows: Sequence[Agreement]) -> str:
    """Build the HTML table of joints or angles; columns with a star are without the constant offset."""
    head = ("", "unit", "frames", "median", "p95", "RMSE", "offset", "median*", "p95*", "RMSE*", "bias", "limits", "r",
            "inside 90 %")  # fmt: skip
    out = []
    for a in rows:
        limits = " / ".join(f"{low:.0f}..{high:.0f}" for low, high in zip(a.low, a.high, strict=True))
        covered = a.covered[SETTINGS.compare_levels.index(0.9)]
        cells = [html.escape(a.name), a.unit, str(a.n), *map(number_text, _distances(a))]
        cells += [
            " / ".join(number_text(v) for v in a.bias.tolist()),
            limits,
            " / ".join(f"{v:.3f}" for v in a.r.tolist()),
        ]
        cells.append("-" if covered != covered else f"{100 * covered:.0f} %")
        out.append(cells)
    return html_table(out, head, range(1, len(head))) + "<p class='dim'>* without the constant offset</p>"


def _errors(found: Comparison) -> str:
    """Draw the distance of the worst joint (grey) and of the median joint (blue) over time."""
    seen = np.isfinite(found.errors).any(1)
    if seen.sum() < 2:
        return ""
    times, errors = found.times[seen], found.errors[seen]
    x, top, lines = 1000 * (times - times[0]) / np.ptp(times), max(float(np.nanmax(errors)), 1e-9), []
    for of, colour in ((np.nanmax, "#999999"), (np.nanmedian, "#2679c0")):
        points = " ".join(f"{u:.1f},{v:.1f}" for u, v in zip(x, 220 * (1 - of(errors, 1) / top), strict=True))
        lines.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.4"/>')
    look = 'width="1000" viewBox="0 0 1000 220" style="border-left: 1px solid; border-bottom: 1px solid"'
    text = f"0 to {top:.0f} mm from {times[0]:.2f} to {times[-1]:.2f} s; grey: worst joint, blue: median joint."
    return f"<figure><svg {look}>{''.join(lines)}</svg><figcaption>{text}</figcaption></figure>"
