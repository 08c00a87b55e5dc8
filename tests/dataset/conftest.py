import shutil

import pytest
from small_dataset import make


@pytest.fixture(scope="session")
def reference(tmp_path_factory):
    directory = tmp_path_factory.mktemp("reference")
    return directory, make(directory)


@pytest.fixture
def copy(reference, tmp_path):
    return shutil.copytree(reference[0], tmp_path / "copy")
