"""`hypose` and `python -m hypose.app`: the command line."""

import os
import sys

# Work is shared out by hypose itself. What numpy shares out is small, and on a busy machine its threads wait for
# each other: a product of 1 ms then takes 20.
for _threads in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")
os.environ["PYTHONSAFEPATH"] = "1"  # no process that is started imports what lies in the current folder


def main() -> None:
    """Run the command line with the arguments of the process; exits the process."""
    # a stream that is closed (`>&-`) fails when it is used, as on a full disk, and no file of ours takes its number
    for name, flags in (("stdin", os.O_RDONLY), ("stdout", os.O_RDONLY), ("stderr", os.O_WRONLY)):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.open(os.devnull, flags), "r" if name == "stdin" else "w"))
    try:
        from hypose.app.cli import run_cli as run
    except KeyboardInterrupt:
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
