"""The list of jobs in a file of the served folder, so that it outlives the server.

Only what the page shows is kept, and what it had asked for: what a job of an earlier server would run when it is
resumed is planned again from that, as for any wish of the page. So nobody who writes this file gets a command run that
the page could not ask for.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from hypose.app.studio.catalog import Catalog
from hypose.app.studio.job_kinds import KINDS, Plan, plan
from hypose.app.studio.job_record import ENDED, Job, Stage
from hypose.app.studio.view_bundle import plain
from hypose.errors import HyposeError
from hypose.io.files import read_json, write_text

NAME = ".studio-jobs.json"
_KEPT_LINES = 40
_INTERRUPTED = "The server ended while this job was under way; what it had computed is kept."


def read_jobs(catalog: Catalog) -> list[Job]:
    """The jobs that an earlier server has left, none of them running. What cannot be read is left out."""
    path = catalog.root / NAME
    if not path.is_file() or not catalog.contains(path):
        return []
    try:
        records = read_json(path, "a list of jobs")
    except HyposeError:
        return []
    found = []
    for record in records if isinstance(records, list) else []:
        with contextlib.suppress(KeyError, TypeError, ValueError, AttributeError):
            found.append(_job_of(record, catalog))
    return found


def write_jobs(catalog: Catalog, jobs: Iterable[Job]) -> None:
    """Keep the list. A folder that may not be written to keeps none, nor does one in which nothing was ever started."""
    path = catalog.root / NAME
    shown = [j.shown() for j in jobs]
    with contextlib.suppress(OSError, HyposeError):
        if not path.is_symlink() and (shown or path.exists()):
            write_text(path, json.dumps(plain([{**s, "lines": s["lines"][-_KEPT_LINES:]} for s in shown])))


def _job_of(record: Mapping[str, Any], catalog: Catalog) -> Job:
    """A job from what the page was shown of it."""
    kind, title = str(record["kind"]), str(record["title"])
    if kind not in KINDS:
        raise ValueError(kind)
    recording, result = _text(record["recording"]), _text(record["result"])
    request = {"recording": recording, "result": result, "options": dict(record["options"])}
    made = Plan((), title, recording, result, makes=_text(record.get("makes")))
    if record["resumable"] or record["state"] not in ENDED:
        with contextlib.suppress(HyposeError):  # its recording may be gone
            made = replace(plan(kind, request, catalog), title=title)
    stages = {
        str(s["name"]): Stage(str(s["title"]), 0.0, int(s["done"]), int(s["total"]), float(s["seconds"]))
        for s in record["stages"]
    }
    interrupted = record["state"] not in ENDED
    job = Job(
        str(record["id"]),
        kind,
        made,
        request["options"],
        float(record["created"]),
        "failed" if interrupted else record["state"],
        stages,
        error=_INTERRUPTED if interrupted else _text(record["error"]),
        began=_number(record["began"]),
        ended=_number(record["ended"]),
        command=str(record["command"]),
    )
    job.lines.extend(str(line) for line in record["lines"])
    return job


def _text(value: Any) -> str | None:
    return None if value is None else str(value)


def _number(value: Any) -> float | None:
    return None if value is None else float(value)
