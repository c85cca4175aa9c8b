"""How soon results are open in the page, what the server then needs, and how many pictures of a session come a second:
in headless Chromium, which draws on the processor, with a server that is a process of its own."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.bench_origin import ROOT
from benchmarks.bench_report import BenchOptions, BenchReport, Row
from benchmarks.studio.long_results import long_result, long_session
from hypose.errors import InputError

_WALKS = ROOT / "web" / "tests"
_CHROMIUM = ("/usr/lib/chromium/chromium", "chromium", "google-chrome")
_LONG, _TEN_MINUTES, _RESULTS = 60_000, 15_000, 10
_PATIENCE_S = 900


def studio(options: BenchOptions) -> BenchReport:
    """opens_s of a result of 60 000 frames that the server has not seen, of the same once more (what the page takes),
    and of the slowest of ten results of 15 000 frames with pictures opened one after the other; server_mb: resident
    memory of the server of these ten, at most and after the last one; pictures_per_s, click_p50_ms and click_p95_ms of
    the gesture screen while a session of 30 pictures a second is watched; their baseline is a bare canvas that shows
    the same pictures."""
    node, browser = _programs()
    frames = (_LONG // 10, _TEN_MINUTES // 10) if options.quick else (_LONG, _TEN_MINUTES)
    with tempfile.TemporaryDirectory() as temporary:
        root, alone = Path(temporary) / "root", Path(temporary) / "alone"
        root.mkdir()
        options.progress("recording", 0, 1)
        # a process of its own, so that what it compiles is not the server's
        _hypose("demo", "--seconds", "1", "--out", str(root / "walk"))
        results = root / "walk" / "results"
        long_result(results / "default", alone / "long", frames[0])
        for k in range(_RESULTS):
            long_result(results / "default", results / f"result-{k}", frames[1])
        long_session(root / "gestures")
        options.progress("recording", 1, 1)
        environment = {**os.environ, "CHROMIUM": browser, "HOME": temporary, "PICTURES": temporary}
        options.progress("opened", 0, 3)
        with _server(alone) as server:
            long, again = (_walk(node, "opening", server.address, environment) for _ in range(2))
        options.progress("opened", 1, 3)
        with _server(root) as server:
            ten = _walk(node, "opening", server.address, {**environment, "OPEN": "/result-"})
            peak, after = server.memory()
        options.progress("opened", 2, 3)
        with _server(root) as server:
            speed = _walk(node, "gesture_speed", server.address, environment)
        options.progress("opened", 3, 3)
    return BenchReport(_rows(long, again, ten, peak, after, speed), {"frames": list(frames), "results": _RESULTS})


def _rows(
    long: dict[str, Any],
    again: dict[str, Any],
    ten: dict[str, Any],
    peak: float,
    after: float,
    speed: dict[str, Any],
) -> tuple[Row, ...]:
    seconds = [r["seconds"] for r in ten["results"]]
    rows = [
        Row("opens_s", "long result", long["results"][0]["seconds"], "s"),
        Row("opens_s", "long result again", again["results"][0]["seconds"], "s"),
        Row("opens_s", "slowest of ten", max(seconds), "s", n=len(seconds)),
        Row("server_mb", "at most", peak, "MB"),
        Row("server_mb", "after ten results", after, "MB"),
    ]
    for case, title in (("alone", "gesture screen"), ("with_body_and_plots", "gesture screen, View beside it")):
        for metric, unit in (("pictures_per_s", "1/s"), ("click_p50_ms", "ms"), ("click_p95_ms", "ms")):
            bare = speed["bare"][metric]
            rows.append(Row(metric, title, speed[case][metric], unit, baseline="bare canvas", baseline_value=bare))
    return tuple(rows)


@dataclass
class _Served:
    address: str
    process: subprocess.Popen[str]

    def memory(self) -> tuple[float, float]:
        """Resident memory of the server (MB): at most, and now."""
        text = Path(f"/proc/{self.process.pid}/status").read_text()
        return tuple(int(re.search(rf"{name}:\s+(\d+) kB", text)[1]) / 1024 for name in ("VmHWM", "VmRSS"))  # type: ignore[index, return-value]


@contextlib.contextmanager
def _server(root: Path) -> Iterator[_Served]:
    command = [sys.executable, "-u", "-m", "hypose.app", "view", str(root), "--port", "0", "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    late = threading.Timer(_PATIENCE_S, process.kill)
    late.start()
    try:
        said = []
        for line in process.stdout:
            said.append(line)
            if found := re.search(r"http://\S+/", line):
                yield _Served(found[0], process)
                return
        raise InputError(f"`hypose view` did not start: {' '.join(said)[-400:]}")
    finally:
        late.cancel()
        process.terminate()
        process.wait(60)


def _walk(node: str, name: str, address: str, environment: dict[str, str]) -> dict[str, Any]:
    """What a walk through the page measures: its last line."""
    done = subprocess.run(
        [node, str(_WALKS / f"{name}.walk.mjs")],
        cwd=_WALKS.parent,
        env={**environment, "STUDIO": address},
        capture_output=True,
        text=True,
        timeout=_PATIENCE_S,
    )
    if done.returncode:
        raise InputError(f"The walk {name} through the page failed: {done.stderr[-600:]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def _hypose(*arguments: str) -> None:
    done = subprocess.run([sys.executable, "-m", "hypose.app", *arguments], capture_output=True, text=True)
    if done.returncode:
        raise InputError(f"`hypose {' '.join(arguments)}` failed: {done.stderr[-400:]}")


def _programs() -> tuple[str, str]:
    """Node and Chromium; an InputError when something is missing, before anything is made."""
    sys.path.insert(0, str(ROOT))
    import hatch_build

    browser = next((p for name in _CHROMIUM if (p := shutil.which(name))), None)
    if browser is None or not sys.platform.startswith("linux"):
        raise InputError("This benchmark needs Linux with Chromium (Debian, Ubuntu: apt install chromium).")
    if not (_WALKS.parent / "node_modules" / "playwright-core").is_dir():
        raise InputError("This benchmark needs the browser's driver: python hatch_build.py --tests")
    try:
        hatch_build.build_page()
        return hatch_build.find_node()[0], browser
    except hatch_build.PageError as error:
        raise InputError(f"The page cannot be built: {error}") from None
