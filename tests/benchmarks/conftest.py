import pytest

from benchmarks.__main__ import bench as measure
from hypose.app.cli import make_command, run_cli


@pytest.fixture
def bench(capsys):
    """bench(*arguments) -> (exit code, stdout, stderr) of the benchmarks' command line, run in this process."""

    def run(*arguments):
        with pytest.raises(SystemExit) as stopped:
            run_cli([str(a) for a in arguments], make_command("benchmarks", measure), "benchmarks")
        printed = capsys.readouterr()
        return stopped.value.code or 0, printed.out, printed.err

    return run
