"""A job as it is known while it runs and afterwards: what the page sees of it."""

from __future__ import annotations

import shlex
import subprocess
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from hypose.app.commands.console import COUNTED_IN_FRAMES
from hypose.app.studio.job_kinds import Plan

JobState = Literal["queued", "running", "done", "failed", "cancelled"]
ENDED: tuple[JobState, ...] = ("done", "failed", "cancelled")
_KEPT_LINES = 200


@dataclass
class Stage:
    """How far a stage of a job is. began: time.monotonic() of its first progress; seconds: from then to its last."""

    title: str
    began: float
    done: int = 0
    total: int = 1
    seconds: float = 0.0

    def shown(self, name: str) -> dict[str, Any]:
        """As the page gets it."""
        per_s = self.done / self.seconds if self.seconds > 0.2 and self.done else None
        return {
            "name": name,
            "title": self.title,
            "done": self.done,
            "total": self.total,
            "seconds": round(self.seconds, 2),
            "per_s": per_s,
            "left_s": (self.total - self.done) / per_s if per_s and self.done < self.total else None,
            "unit": "frames" if name in COUNTED_IN_FRAMES else "",
        }


@dataclass
class Job:
    """One job. Changed under the lock of Jobs only. command: what the page shows, of a job whose plan is not known any
    more; hopeless: to go on would end as it did."""

    id: str
    kind: str
    plan: Plan
    options: Mapping[str, Any]
    created: float
    state: JobState = "queued"
    stages: dict[str, Stage] = field(default_factory=dict)
    lines: deque[str] = field(default_factory=lambda: deque(maxlen=_KEPT_LINES))
    error: str | None = None
    began: float | None = None
    ended: float | None = None
    stopping: bool = False
    hopeless: bool = False
    process: subprocess.Popen[str] | None = None
    command: str = ""

    def shown(self) -> dict[str, Any]:
        """As the page gets it."""
        return {
            "id": self.id,
            "kind": self.kind,
            "title": self.plan.title,
            "command": self.command or "hypose " + shlex.join(self.plan.arguments),
            "recording": self.plan.recording,
            "result": self.plan.result,
            "makes": self.plan.makes,
            "state": self.state,
            "options": dict(self.options),
            "stages": [s.shown(n) for n, s in list(self.stages.items())],
            "lines": list(self.lines),
            "error": self.error,
            "created": self.created,
            "began": self.began,
            "ended": self.ended,
            "resumable": self.plan.resumable and self.state in ("failed", "cancelled") and not self.hopeless,
        }
