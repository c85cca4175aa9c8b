"""What all tests share: real recordings when they are there, and a seeded source of randomness."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
SHARED_DATA = ROOT.parent / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """shared_data(name): path of one of the real recordings; without it the test is skipped, aloud."""

    def find(name: str) -> Path:
        path = SHARED_DATA / name
        if not path.exists():
            pytest.skip(f"real recording not found: {path}")
        return path

    return find


@pytest.fixture
def rng() -> np.random.Generator:
    """A fresh generator with the same seed for every test, so that no test depends on which ran before it."""
    return np.random.default_rng(20240607)
