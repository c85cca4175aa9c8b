from __future__ import annotations

import numpy as np
import pytest

from hypose.synthetic.subjects import Subject
from tests.procedural_subject import procedural_subject


@pytest.fixture(scope="session")
def person() -> Subject:
    return procedural_subject(np.random.default_rng(7), 1.75)
