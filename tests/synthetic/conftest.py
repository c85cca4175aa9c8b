import pytest

from hypose.synthetic.subjects import SyntheticSubject, load_subjects


@pytest.fixture(scope="session")
def person() -> SyntheticSubject:
    return load_subjects()["neutral"]
