"""The sound of a video: a WAV file beside it, or what ffmpeg decodes from it."""

from __future__ import annotations

import shutil
import subprocess
import wave
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hypose.errors import InputError
from hypose.geometry import Array
from hypose.io.files import open_file

_RATE = 16000
_MAX_BYTES = 4 << 30


@dataclass(frozen=True)
class Sound:
    """samples (N,) in -1..1 at rate Hz; the first belongs to the start of frame 0."""

    rate: int
    samples: Array


def read_sound(video: Path) -> Sound:
    """The sound that was recorded with a video, all channels as one. An InputError says what is missing."""
    beside = video.with_suffix(".wav")
    if beside.is_file():
        return _read_wav(beside)
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is not None:
        command = [
            ffmpeg,
            "-v",
            "error",
            "-i",
            str(video.absolute()),
            "-vn",
            "-ac",
            "1",
            "-ar",
            str(_RATE),
            "-f",
            "s16le",
            "-",
        ]
        done = subprocess.run(command, capture_output=True, check=False, cwd=Path(__file__).parent)
        if done.returncode == 0 and len(done.stdout) > 2:
            return Sound(_RATE, np.frombuffer(done.stdout, np.int16).astype(np.float64) / 32768)
        raise InputError(f"{video} has no sound that ffmpeg can read; use --by motion, or put {beside.name} beside it.")
    raise InputError(
        f"The sound of {video} cannot be read, since ffmpeg is not installed; install it, or write the sound to "
        f"{beside.name} beside the video (mono or stereo WAV)."
    )


def _read_wav(path: Path) -> Sound:
    try:
        with open_file(path, "a WAV file", _MAX_BYTES) as stream, wave.open(stream) as file:
            width, channels, rate = file.getsampwidth(), file.getnchannels(), file.getframerate()
            data = file.readframes(file.getnframes())
    except (wave.Error, EOFError, OSError) as error:
        raise InputError(f"{path} is no WAV file that can be read ({error}); export it as 16-bit PCM.") from None
    if width not in (1, 2, 4) or channels < 1 or rate < 1000:
        raise InputError(f"{path}: {8 * width} bits at {rate} Hz; export it as 16-bit PCM with at least 8000 Hz.")
    kind = {1: np.uint8, 2: np.int16, 4: np.int32}[width]
    samples = np.frombuffer(data[: len(data) // (width * channels) * width * channels], kind).astype(np.float64)
    samples = (samples - 128) / 128 if width == 1 else samples / float(np.iinfo(kind).max)
    return Sound(int(rate), samples.reshape(-1, channels).mean(1))
