"""`hypose` and `python -m hypose.app`: the command line, once damaged bytecode can do it no harm."""

from hypose.app.bytecode import check_bytecode


def main() -> None:
    """Run the command line with the arguments of the process; exits the process."""
    check_bytecode()
    from hypose.app.cli import main as run

    run()


if __name__ == "__main__":
    main()
