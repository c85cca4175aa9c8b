"""Set hypose up in this folder and run it: what `make` and `./run` call. Standard library only.

    python3 scripts/bootstrap.py demo | test | lint | bench | docs | setup | <any other hypose command> [arguments]

1. Inside a virtual environment (venv, or conda other than `base`) that one is used.
2. Otherwise `.venv` is made in this folder, in the first way that works: uv; venv; venv without pip, filled
   by the system's pip (Debian without python3-venv); a uv that the system's pip puts into `.cache`. None of
   them installs into the system's Python, so an "externally managed" one (PEP 668) is no obstacle.
3. The packages are installed when pyproject.toml has changed since the last time; else this costs nothing.

Caches and temporary files go to `.cache` in this folder; nothing is left outside it. This file keeps to the
syntax of Python 3.6, so that an old Python gets as far as saying that it is too old.
"""

import hashlib
import importlib
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from typing import Dict, List, NamedTuple, Optional, Tuple

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
CACHE = os.path.join(ROOT, ".cache")
OWN_ENVIRONMENT = os.path.join(ROOT, ".venv")
LAST_TEST_FILE = os.path.join(CACHE, "last-test")
MINIMUM = (3, 11)
PIP_WITH_PYTHON_OPTION = (22, 3)  # the first pip that can install into another environment

# What a command needs: `core` is hypose itself, `dev` adds the developers' tools and what benchmarks use, `oracles`
# adds, where they can be had, the programs that tests compare with and the extras that tests use.
PROFILES = ("core", "dev", "oracles")
PROFILE_OF_COMMAND = {"test": "oracles", "setup": "oracles", "lint": "dev", "bench": "dev", "docs": "dev"}


class SetupError(Exception):
    """Something the user can mend; the message is one sentence with the next step."""


class Machine(NamedTuple):
    """What decides how to set up: looked up once, so that the decisions are plain functions of it."""

    python: str
    version: Tuple[int, ...]
    prefix: str
    base_prefix: str
    conda_prefix: Optional[str]
    conda_name: Optional[str]
    venv: bool
    ensurepip: bool
    pip: Optional[Tuple[int, ...]]
    uv: Optional[str]


# --- decisions ---


def uses_current_environment(machine: Machine) -> bool:
    """True inside a venv or an activated conda environment. Conda's `base` does not count: it is often active
    without having been asked for, and it carries conda itself."""
    if machine.prefix != machine.base_prefix:
        return True
    in_conda = machine.conda_prefix is not None and os.path.normpath(machine.conda_prefix) == os.path.normpath(
        machine.prefix
    )
    return in_conda and machine.conda_name != "base"


def ways_to_make_environment(machine: Machine) -> List[str]:
    """The ways that can work on this machine, best first; SetupError if there is none."""
    ways = []
    if machine.uv:
        ways.append("uv")
    if machine.venv and machine.ensurepip:
        ways.append("venv")
    if machine.venv and machine.pip and machine.pip >= PIP_WITH_PYTHON_OPTION:
        ways.append("venv-without-pip")
    if machine.pip:
        ways.append("borrowed-uv")
    if not ways:
        raise SetupError(
            f"{machine.python} has neither pip nor a complete venv module; install one of them "
            "(Debian, Ubuntu: sudo apt install python3-venv) and run this again."
        )
    return ways


def ways_to_install(machine: Machine, environment_has_pip: bool, borrowed_uv: Optional[str]) -> List[str]:
    """The installers that can fill an environment, best first; SetupError if there is none."""
    ways = []
    if machine.uv or borrowed_uv:
        ways.append("uv")
    if environment_has_pip:
        ways.append("pip")
    elif machine.pip and machine.pip >= PIP_WITH_PYTHON_OPTION:
        ways.append("outer-pip")
    if not ways:
        raise SetupError(
            "The environment has no pip and no uv was found; remove .venv (or leave the active environment) "
            "and run this again, or install uv."
        )
    return ways


def install_command(way: str, machine: Machine, python: str, borrowed_uv: Optional[str]) -> List[str]:
    """The command line, without requirements, that installs wheels into the environment of `python`."""
    if way == "uv":
        return [machine.uv or borrowed_uv or "uv", "pip", "install", "--python", python]
    options = [
        "install",
        "--no-cache-dir",
        "--disable-pip-version-check",
        "--progress-bar",
        "off",
    ]
    if way == "pip":
        return [python, "-m", "pip"] + options
    return [machine.python, "-m", "pip", "--python", python] + options


def fingerprint(pyproject: bytes, version: Tuple[int, ...]) -> str:
    """Changes when an installation has to be repeated."""
    return hashlib.sha256(pyproject + repr(version[:2]).encode()).hexdigest()


def requirements(extras: Dict[str, List[str]], name: str) -> List[str]:
    """The requirements of an extra of hypose, with those of the extras that it names in the place of these: each can
    then be tried by itself, and pip looks for no hypose in an index."""
    lines = []  # type: List[str]
    for line in extras[name]:
        others = re.match(r"hypose\[([\w,]+)\]$", line)
        if others:
            lines += [one for other in others.group(1).split(",") for one in requirements(extras, other)]
        else:
            lines.append(line)
    return lines


def is_installed(stamp: Dict[str, object], wanted: str, profile: str) -> bool:
    """True when an earlier installation covers `profile` at fingerprint `wanted` in this very folder."""
    done = stamp.get("profile")
    return (
        stamp.get("fingerprint") == wanted
        and stamp.get("folder") == ROOT
        and done in PROFILES
        and PROFILES.index(done) >= PROFILES.index(profile)
    )


def contained(environment: Dict[str, str]) -> Dict[str, str]:
    """The environment variables of all that is started here: caches and temporary files inside the folder."""
    inside = {
        "XDG_CACHE_HOME": ".",
        "TMPDIR": "tmp",
        "HYPOSE_CACHE_DIR": "hypose",
        "MPLCONFIGDIR": "matplotlib",
        "PIP_CACHE_DIR": "pip",
        "UV_CACHE_DIR": "uv-cache",
        "RUFF_CACHE_DIR": "ruff",
        "npm_config_cache": "npm",
    }
    result = dict(environment)
    result.update({name: os.path.normpath(os.path.join(CACHE, folder)) for name, folder in inside.items()})
    result.pop("PYTHONHOME", None)
    result.setdefault("PIP_RETRIES", "2")  # a variable, since pip starts another pip: give up soon without a network
    return result


def why_it_failed(log: str) -> str:
    """One sentence on a failed installation, from what the installer printed."""
    network = (
        "Temporary failure in name resolution",
        "Name or service not known",
        "nodename nor servname",
        "Failed to establish a new connection",
        "Network is unreachable",
        "ConnectTimeoutError",
        "dns error",
        "error sending request",
        "Connection refused",
        "ProxyError",
    )
    if any(text in log for text in network):
        return "The package index cannot be reached: connect to the network (or set PIP_INDEX_URL to a mirror)"
    if "No space left on device" in log:
        return "The disk is full: about 1.5 GB are needed in this folder"
    if "No matching distribution found" in log or "no wheels with a matching" in log or "no version of" in log:
        version = ".".join(map(str, sys.version_info[:2]))
        return f"Not every package has a wheel for this platform and Python {version}: try Python 3.11 or 3.12"
    return "Installing the packages failed; the reason is above and in .cache/setup.log: mend it"


# --- looking and doing ---


def look() -> Machine:
    """This machine."""
    pip = None  # type: Optional[Tuple[int, ...]]
    if importlib.util.find_spec("pip"):
        words = importlib.import_module("pip").__version__.split(".")
        pip = tuple(int(word) for word in words[:2] if word.isdigit())
    return Machine(
        python=sys.executable,
        version=tuple(sys.version_info[:3]),
        prefix=sys.prefix,
        base_prefix=sys.base_prefix,
        conda_prefix=os.environ.get("CONDA_PREFIX"),
        conda_name=os.environ.get("CONDA_DEFAULT_ENV"),
        venv=importlib.util.find_spec("venv") is not None,
        ensurepip=importlib.util.find_spec("ensurepip") is not None,
        pip=pip,
        uv=shutil.which("uv"),
    )


def program(folder: str, name: str) -> str:
    """Path of a program of the environment in `folder`."""
    return os.path.join(folder, "Scripts", name + ".exe") if os.name == "nt" else os.path.join(folder, "bin", name)


def call(command: List[str], log: List[str], show: bool = True) -> bool:
    """Run, collect what it prints in `log`, show what tells of progress; True on success."""
    log.append("$ " + " ".join(command) + "\n")
    try:
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            env=contained(dict(os.environ)),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            universal_newlines=True,
            errors="replace",
        )
    except OSError as error:
        log.append(f"{error}\n")
        return False
    assert process.stdout is not None
    for line in process.stdout:
        log.append(line)
        if show and line.lstrip().startswith(("Collecting", "Downloading", "Installing", "ERROR", "error")):
            print("  " + line.strip()[:118], flush=True)
    return process.wait() == 0


def answers(python: str, code: str) -> bool:
    """True when this Python exists and runs the code without an error."""
    try:
        return subprocess.call([python, "-c", code], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) == 0
    except OSError:
        return False


def borrow_uv(machine: Machine, log: List[str]) -> Optional[str]:
    """A uv of this folder's own, put there by the system's pip (`--target` is allowed under PEP 668)."""
    target = os.path.join(CACHE, "uv")
    uv = os.path.join(target, "bin", "uv.exe" if os.name == "nt" else "uv")
    if not os.path.exists(uv):
        call([machine.python, "-m", "pip", "install", "--no-cache-dir", "--target", target, "uv"], log)
    return uv if os.path.exists(uv) else None


def make_environment(machine: Machine, log: List[str]) -> None:
    """Make `.venv` in the first way that works."""
    for way in ways_to_make_environment(machine):
        shutil.rmtree(OWN_ENVIRONMENT, ignore_errors=True)
        if way == "uv" or way == "borrowed-uv":
            uv = machine.uv if way == "uv" else borrow_uv(machine, log)
            made = uv is not None and call([uv, "venv", "--python", machine.python, OWN_ENVIRONMENT], log, False)
        else:
            options = ["--without-pip"] if way == "venv-without-pip" else []
            made = call([machine.python, "-m", "venv"] + options + [OWN_ENVIRONMENT], log, False)
        if made and answers(program(OWN_ENVIRONMENT, "python"), "import ctypes"):
            return
    shutil.rmtree(OWN_ENVIRONMENT, ignore_errors=True)
    raise SetupError(
        f"{machine.python} could not make .venv (details: .cache/setup.log); install python3-venv "
        "(Debian, Ubuntu: sudo apt install python3-venv) and run this again."
    )


def read_stamp(path: str) -> Dict[str, object]:
    """The stamp of the last installation; empty when there is none or it is damaged."""
    try:
        with open(path, encoding="utf-8") as file:
            stamp = json.load(file)
    except (OSError, ValueError):
        return {}
    return stamp if isinstance(stamp, dict) else {}


def install(machine: Machine, python: str, profile: str, log: List[str]) -> List[str]:
    """Install hypose and what `profile` needs; returns the names of the oracles that could not be had."""
    import tomllib  # here and not above: an old Python has none

    has_pip = answers(python, "import pip")
    borrowed = os.path.join(CACHE, "uv", "bin", "uv")
    borrowed_uv = borrowed if os.path.exists(borrowed) else None
    if not (machine.uv or borrowed_uv or has_pip) and machine.pip and machine.pip < PIP_WITH_PYTHON_OPTION:
        borrowed_uv = borrow_uv(machine, log)
    target = ["-e", ROOT if profile == "core" else ROOT + "[dev]"]
    oracles = []  # type: List[str]
    if profile == "oracles":
        with open(os.path.join(ROOT, "pyproject.toml"), "rb") as file:
            oracles = requirements(tomllib.load(file)["project"]["optional-dependencies"], "oracles")
    wheels = ["--only-binary", ":all:"]  # building one of the oracles would take an hour and a compiler
    command = []  # type: List[str]
    start = len(log)
    for way in ways_to_install(machine, has_pip, borrowed_uv):
        command = install_command(way, machine, python, borrowed_uv)
        if oracles and call(command + target + wheels + oracles, log):
            return []
        start = len(log)
        if call(command + target, log):
            break
    else:
        print("".join([line for line in log[start:] if "WARNING" not in line][-8:]), file=sys.stderr)
        raise SetupError(why_it_failed("".join(log)) + ", then run this again.")
    # One by one, and with hypose itself on the line: an oracle cannot bring a version that hypose refuses.
    missing = [one for one in oracles if not call(command + target + wheels + [one], log)]
    return [one.split(">")[0].split("=")[0].strip() for one in missing]


def prepare(machine: Machine, profile: str, again: bool = False) -> str:
    """Set up what `profile` needs; returns the folder of the environment."""
    os.makedirs(os.path.join(CACHE, "tmp"), exist_ok=True)
    own = not uses_current_environment(machine)
    folder = OWN_ENVIRONMENT if own else machine.prefix
    python = program(folder, "python") if own else machine.python
    stamp_path = os.path.join(folder, ".hypose-setup.json")
    stamp = read_stamp(stamp_path)
    with open(os.path.join(ROOT, "pyproject.toml"), "rb") as file:
        wanted = fingerprint(file.read(), machine.version)
    if is_installed(stamp, wanted, profile) and os.path.exists(python) and not again:
        missing = stamp.get("missing")
    else:
        log = []  # type: List[str]
        try:
            if own:
                moved = stamp.get("folder") not in (None, ROOT)  # its programs name the old place
                usable = answers(python, f"import sys; sys.exit(sys.version_info[:2] < {MINIMUM})")
                if moved or not usable:
                    print(f"hypose: making the environment {folder}", flush=True)
                    make_environment(machine, log)
            if stamp.get("fingerprint") == wanted and stamp.get("folder") == ROOT and os.path.exists(stamp_path):
                profile = max(profile, str(stamp.get("profile")), key=PROFILES.index)  # never forget what is there
            print(f"hypose: installing packages into {folder} (once; a few minutes)", flush=True)
            missing = install(machine, python, profile, log)
        finally:
            with open(os.path.join(CACHE, "setup.log"), "w", encoding="utf-8") as file:
                file.writelines(log)
        stamp = {"fingerprint": wanted, "folder": ROOT, "profile": profile, "missing": missing}
        with open(stamp_path, "w", encoding="utf-8") as file:
            json.dump(stamp, file)
    if missing and isinstance(missing, list) and profile == "oracles":
        names = ", ".join(map(str, missing))
        print(
            f"hypose: NOTE {names} could not be installed (.cache/setup.log); the tests that need it "
            "will be SKIPPED. `make setup` tries again.",
            flush=True,
        )
    return folder


def prepare_page(python: str) -> None:
    """The studio's page and what its tests drive the browser with, where they can be had; nothing to do mostly."""
    log = []  # type: List[str]
    if not call([python, os.path.join(ROOT, "hatch_build.py"), "--tests"], log, False):
        print(f"hypose: NOTE the studio's page will not be tested in a browser: {log[-1].strip()}", flush=True)


def at_once(arguments: List[str]) -> List[str]:
    """pytest's options for several processes, as many as processors may be used, at most four, for each takes about a
    gigabyte; each takes whole files, which share what they make. None where the arguments say how, or want to ask."""
    if any(a.startswith(("-n", "--numprocesses", "--dist", "--pdb", "--trace", "-p")) or a == "-s" for a in arguments):
        return []
    mine = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return ["-n", str(min(mine, 4)), "--dist", "loadfile"] if mine > 1 else []


def commands_of(name: str, arguments: List[str], folder: str, python: str) -> List[List[str]]:
    """The command lines behind a command; all of them are run."""
    if name == "setup":
        return []
    if name == "test":
        return [[python, "-m", "pytest"] + at_once(arguments) + arguments]
    if name == "lint":
        return [
            [program(folder, "ruff"), "format", "--check", "."],
            [program(folder, "ruff"), "check", "."],
            [program(folder, "pyright"), "--pythonpath", python],
            [program(folder, "lint-imports"), "--cache-dir", os.path.join(CACHE, "import-linter")],
            [python, "-m", "scripts.words"],
            [python, "-m", "scripts.size"],
        ]
    if name == "bench":
        return [[python, "-m", "benchmarks"] + arguments]
    if name == "docs":
        return [[python, "-m", "scripts.docs"] + arguments, [python, "-m", "mkdocs", "build", "--quiet", "--strict"]]
    return [[program(folder, "hypose"), name] + arguments]


def run(command: List[str], folder: Optional[str], environment: Dict[str, str]) -> int:
    """Run with the terminal's own input and output. On Ctrl-C the program, which gets it too, ends by itself:
    it may have work to save (subprocess.call would kill it after a quarter of a second)."""
    process = subprocess.Popen(command, cwd=folder, env=environment)
    while True:
        try:
            return process.wait()
        except KeyboardInterrupt:
            continue


def ended_by_a_signal(number: int) -> str:
    """What to say when the tests' process did not end by itself."""
    try:
        with open(LAST_TEST_FILE) as file:
            last = file.read()
    except OSError:
        last = "not known"
    return f"The tests were ended by signal {number}; the last one that began: {last}"


def newer_python() -> Optional[str]:
    """A Python of this machine that is new enough, when `python3` is not."""
    for minor in (12, 11, 13, 14):
        found = shutil.which(f"python3.{minor}")
        if found and answers(found, f"import sys; sys.exit(sys.version_info[:2] < {MINIMUM})"):
            return found
    return None


def main(arguments: List[str]) -> int:
    """Set up, run, return the exit status."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(__doc__)
        return 0 if arguments else 2
    name, rest = arguments[0], arguments[1:]
    try:
        machine = look()
        if machine.version[:2] < MINIMUM:
            other = newer_python()
            if other is None or uses_current_environment(machine):
                raise SetupError(
                    f"Python {MINIMUM[0]}.{MINIMUM[1]} or newer is needed, {sys.executable} is "
                    f"{'.'.join(map(str, machine.version))}; install a newer one and name it: "
                    "make PYTHON=/path/to/python3.11"
                )
            return run([other, os.path.abspath(__file__)] + arguments, None, dict(os.environ))
        folder = prepare(machine, PROFILE_OF_COMMAND.get(name, "core"), again=name == "setup")
        python = program(folder, "python") if folder == OWN_ENVIRONMENT else machine.python
        # hypose's own commands get file names as the user typed them; the others work on the project.
        place = ROOT if name in ("test", "setup", "lint", "docs") else None
        if PROFILE_OF_COMMAND.get(name) == "oracles":
            prepare_page(python)
        worst = 0
        for command in commands_of(name, rest, folder, python):
            if name == "lint":
                print("$ " + " ".join([os.path.basename(command[0])] + command[1:]), flush=True)
            environment = contained(dict(os.environ))
            if name == "docs":
                environment.setdefault("NO_MKDOCS_2_WARNING", "1")
            if name == "test":  # where several processes share the processors, threads of BLAS wait for each other
                environment.setdefault("OPENBLAS_NUM_THREADS", "1")
            status = run(command, place, environment)
            if name == "test" and status < 0:
                print(ended_by_a_signal(-status), flush=True)
            worst = worst or status
        return worst
    except SetupError as error:
        print(f"hypose: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(
            f"hypose: {error}; check the rights and the space in {ROOT}, then run this again.",
            file=sys.stderr,
        )
        return 1
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
