"""Files that cannot be written: the error names them, and nothing is left beside them."""

import os
import resource

import numpy as np
import pytest

from smp_gym.atomic_files import replacing, write_text


@pytest.fixture
def small_files():
    """Let no file grow beyond 100 bytes, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def save_array(path):
    with replacing(path) as aside, open(aside, "wb") as file:
        np.save(file, np.zeros(1000))


def save_text(path):
    write_text(path, "x" * 1000)


@pytest.mark.parametrize("save", [save_array, save_text])
def test_a_missing_folder_is_told_of_by_the_name_that_was_given(tmp_path, save):
    path = tmp_path / "none" / "motion.npy"
    with pytest.raises(FileNotFoundError) as caught:
        save(path)
    assert caught.value.filename == str(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("save", [save_array, save_text])
def test_what_the_system_names_no_file_for_is_named(tmp_path, save, small_files):
    path = tmp_path / "motion.npy"
    path.write_text("before")
    with pytest.raises(OSError, match=r"motion\.npy"):
        save(path)
    assert path.read_text() == "before"
    assert os.listdir(tmp_path) == ["motion.npy"]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="the system has no /dev/full")
def test_a_full_device_is_named(tmp_path):
    link = tmp_path / "motion.csv"
    link.symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left on device: '/dev/full'"):
        save_text(link)


def test_errors_about_other_files_stay_what_they_are(tmp_path):
    other = tmp_path / "other.txt"
    with pytest.raises(FileNotFoundError) as caught, replacing(tmp_path / "motion.csv"):
        other.read_text()
    assert caught.value.filename == str(other)
