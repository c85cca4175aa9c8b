"""Is what the package offers fully typed?  python -m scripts.type_completeness [--floor 95]

Pyright looks at an installed package only, so the package is copied to where its interpreter will find it. Exit code 1
below the floor, with the symbols of unknown type; the kernels that numba compiles are what is left of these.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[1] / "hypose"


def report() -> Mapping[str, Any]:
    """Pyright's report on the types of all public symbols."""
    with tempfile.TemporaryDirectory() as temporary:
        site, elsewhere = Path(temporary) / "site", Path(temporary) / "elsewhere"
        elsewhere.mkdir()  # else the sources at hand would hide the package
        shutil.copytree(PACKAGE, site / PACKAGE.name, ignore=shutil.ignore_patterns("__pycache__", "assets"))
        command = [sys.executable, "-m", "pyright", "--outputjson"]
        # for this report pyright asks the first `python` of PATH where packages are, whatever --pythonpath says
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])
        done = subprocess.run(
            [*command, "--verifytypes", PACKAGE.name, "--ignoreexternal"],
            cwd=elsewhere,
            env={**os.environ, "PATH": path, "PYTHONPATH": str(site)},
            capture_output=True,
            text=True,
        )
    try:
        return json.loads(done.stdout)["typeCompleteness"]
    except (ValueError, KeyError):
        raise SystemExit(f"pyright gave no report: {(done.stderr or done.stdout)[-500:]}") from None


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--floor", type=float, default=95.0, help="per cent of the symbols with a known type")
    floor = parser.parse_args().floor
    found = report()
    score = 100 * float(found["completenessScore"])
    print(f"Types known: {score:.1f} % of the public symbols (at least {floor:g} wanted)")
    if score < floor:
        unknown = [s["name"] for s in found["symbols"] if s["isExported"] and not s["isTypeKnown"]]
        for module, count in Counter(".".join(name.split(".")[:3]) for name in unknown).most_common(20):
            print(f"  {module}: {count}")
        sys.exit(1)


if __name__ == "__main__":
    main()
