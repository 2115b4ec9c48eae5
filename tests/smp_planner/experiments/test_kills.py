"""Kills at random moments: sound work passes, and each fault of unsound work is found."""

import time

import numpy as np
import pytest

from smp_gym.atomic_files import write_text
from smp_planner.experiments.kills.killing import FAULTS, KILLS, Work, killed_at_random

NUMBERS = 12


def _kept(folder):
    return {path.name: int(path.read_text()) for path in folder.glob("[0-9]*")}


def _sound(folder):
    """Keep the squares of some numbers, each in a file of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(NUMBERS):
        path = folder / str(number)
        if not path.exists():
            time.sleep(0.01)
            write_text(path, str(number**2))


def _torn(folder):
    """As `_sound`, but a file is for some time no number."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(NUMBERS):
        path = folder / str(number)
        if not path.exists():
            path.write_text("half of ")
            time.sleep(0.01)
            path.write_text(str(number**2))


def _forgetful(folder):
    """As `_sound`, but what was kept is thrown away in the beginning."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.glob("[0-9]*"):
        path.unlink()
    _sound(folder)


def _confused(folder):
    """As `_sound`, but what follows a kill is another result."""
    began = folder / "began"
    again = began.exists()
    folder.mkdir(parents=True, exist_ok=True)
    began.touch()
    _sound(folder)
    if again:
        write_text(folder / "0", "7")


@pytest.mark.parametrize(
    ("go_on", "fault"),
    [(_sound, None), (_torn, "torn"), (_forgetful, "lost"), (_confused, "other")],
)
def test_the_fault_of_unsound_work_is_found(go_on, fault, tmp_path):
    told = []
    work = Work(go_on.__name__, go_on, _kept)
    tally = killed_at_random(work, tmp_path, 12, np.random.default_rng(0), told.append)
    assert tally[KILLS] == 12
    found = {name for name in FAULTS if tally[name]}
    if fault is None:
        assert not found, told
    else:
        assert fault in found
        assert any(line.startswith(f"{fault}: ") for line in told)


def test_work_that_fails_without_a_kill_is_no_measurement(tmp_path):
    def fail(folder):
        raise ValueError("no such thing")

    with pytest.raises(RuntimeError, match="fails without a kill: ValueError: no such thing"):
        killed_at_random(Work("none", fail, _kept), tmp_path, 1, np.random.default_rng(0))
