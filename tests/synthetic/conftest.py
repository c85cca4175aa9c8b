import pytest

from hypose.synthetic.subjects import Subject, load_subjects


@pytest.fixture(scope="session")
def person() -> Subject:
    return load_subjects()["neutral"]
