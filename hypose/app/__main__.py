"""`hypose` and `python -m hypose.app`: the command line, once damaged bytecode can do it no harm."""

import sys

from hypose.app.bytecode import check_bytecode


def main() -> None:
    """Run the command line with the arguments of the process; exits the process."""
    try:
        check_bytecode()
        from hypose.app.cli import main as run
    except KeyboardInterrupt:
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
