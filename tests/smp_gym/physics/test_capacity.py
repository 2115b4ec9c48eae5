"""Too many environments end in an error that says what to do, and harm none of the others."""

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from smp_gym.physics import capacity, world
from smp_gym.physics.world import BulletWorld

ROOT = Path(__file__).parents[3]

MANY = """
import json, resource, sys
import gymnasium
import smp_gym
from smp_gym.physics.capacity import free_memory

def make():
    env = gymnasium.make("smp_gym/Placement-v0", difficulty="easy", max_episode_steps=3)
    env.reset(seed=0)
    return env

def played(env):
    return env.reset(seed=1)[0]["observation"].tolist(), env.step(env.action_space.low)[1]

first = make()
before = played(first)
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + 300 * 2**20
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
open_, told = [first], []
for _ in range(2):
    try:
        while len(open_) < 50:
            open_.append(make())
    except MemoryError as error:
        told.append([len(open_), str(error)])
    same = [played(env) == before for env in open_]
    # As many as were closed can be opened again.
    for env in open_[1:]:
        env.close()
    del open_[1:]
print(json.dumps([told, same]))
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="asks Linux for the memory left")
def test_what_there_is_no_memory_for_is_refused_and_the_rest_goes_on() -> None:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", MANY],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    told, same = json.loads(done.stdout)
    (first, message), (again, _) = told
    assert 3 <= first <= again < 50
    assert "MB are left" in message
    assert "env.close()" in message
    assert same == [True] * again


def test_no_more_worlds_than_the_engine_has_places(monkeypatch: pytest.MonkeyPatch) -> None:
    worlds = [BulletWorld() for _ in range(2)]
    monkeypatch.setattr(capacity, "MOST_WORLDS", len(world._PLACES))
    with pytest.raises(RuntimeError, match=r"physics worlds in a process, and \d+ are open: close"):
        BulletWorld()
    worlds.pop().close()
    worlds.append(BulletWorld())
    with pytest.raises(RuntimeError, match="several processes"):
        BulletWorld()
    # What is forgotten gives its place back, too.
    del worlds[0]
    worlds.append(BulletWorld())
    for each in worlds:
        each.close()


def test_the_memory_left_shrinks_by_what_is_taken() -> None:
    """Within a limit of this process, for others take and give back memory of the machine."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + 2**30, hard))
    try:
        before = capacity.free_memory()
        taken = bytearray(os.urandom(2**20)) * 300
        assert before - capacity.free_memory() > 100 * 2**20
        assert len(taken) == 300 * 2**20
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
