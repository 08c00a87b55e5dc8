import pathlib

import pytest
from synthetic import train_small


@pytest.fixture(scope="session")
def uninterrupted(tmp_path_factory) -> pathlib.Path:
    """The directory of a small training that nothing disturbed."""
    directory = tmp_path_factory.mktemp("uninterrupted")
    train_small(directory)
    return directory
