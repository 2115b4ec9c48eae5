"""What tests of the benchmark share."""

from pathlib import Path

import pytest
from real_rows import write_folder


@pytest.fixture(scope="session")
def hard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of real results, to be read only."""
    folder = tmp_path_factory.mktemp("results") / "hard"
    write_folder(folder)
    return folder
