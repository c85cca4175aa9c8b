"""What was found of a result that another command goes on with."""

from __future__ import annotations

from pathlib import Path

from hypose.app.commands.console import note


def tell_untrusted(results: Path) -> None:
    """One line when the result (a folder, or its motion.npz) is not to be trusted; what cannot be read says nothing."""
    from hypose.app.jobs.job import VERDICT
    from hypose.errors import InputError
    from hypose.io.files import read_json
    from hypose.pipeline.verdict import UNTRUSTED, Verdict

    folder = results if results.is_dir() else results.parent
    try:
        kept = Verdict.of_document(read_json(folder / VERDICT, "a verdict"))
    except (InputError, ValueError, KeyError, TypeError):
        return
    if kept.word == UNTRUSTED:
        note(f"note: {folder}: {kept.sentence}")
