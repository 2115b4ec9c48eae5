"""Threads share rows, hand on what fails, and change no plan."""

import threading

import numpy as np
import pytest
import torch
from shipped_planners import planners_of

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.sampling import sample_scene
from smp_gym.scene import TASKS
from smp_planner import SMP, Circle
from smp_planner.agents.posed_scenes import posed
from smp_planner.movement_primitives import ProMP
from smp_planner.movement_primitives.mixture import ProMPMixture
from smp_planner.planners import make_planner
from smp_planner.planning import pipeline
from smp_planner.planning.prior import learn_prior
from smp_planner.planning.settings import PriorSettings
from smp_planner.planning.threads import Threads, default_threads


@pytest.mark.parametrize(("threads", "rows"), [(1, 7), (2, 7), (3, 7), (4, 3), (2, 1), (3, 0)])
def test_every_row_is_computed_once(threads, rows):
    done, names = np.zeros(rows, np.int64), set()

    def work(part):
        names.add(threading.get_ident())
        done[part] += 1

    with Threads(threads) as pool:
        for _ in range(3):
            pool.over(rows, work)
    np.testing.assert_array_equal(done, 3)
    assert len(names) <= max(1, min(threads, rows))


def test_threads_work_at_the_same_time():
    meeting = threading.Barrier(3, timeout=30.0)
    with Threads(3) as pool:
        pool.over(3, lambda _: meeting.wait())
    assert not meeting.broken


def test_threads_end_with_the_context():
    before = threading.active_count()
    with Threads(3) as pool:
        pool.over(9, lambda _: None)
        assert threading.active_count() == before + 2
    assert threading.active_count() == before


@pytest.mark.parametrize("failing", [0, 4])
def test_what_fails_in_a_thread_fails_for_the_caller_after_all_are_done(failing):
    done = []

    def work(part):
        if part.start <= failing < part.stop:
            raise ArithmeticError("no such row")
        done.append(part)

    with Threads(2) as pool:
        with pytest.raises(ArithmeticError, match="no such row"):
            pool.over(6, work)
        assert len(done) == 1
        pool.over(6, lambda part: done.append(part))
    assert len(done) == 3


@pytest.mark.parametrize("count", [0, -1, 1.5, True, None])
def test_a_number_of_threads_that_is_none_is_refused(count):
    with pytest.raises(ValueError, match="threads must be a positive integer, got"):
        Threads(count)


def test_a_plan_uses_as_many_threads_as_torch():
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        assert default_threads() == 1
    finally:
        torch.set_num_threads(before)


@pytest.fixture
def torch_threads():
    """Set the number of threads of torch, and set it back at the end."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


def test_what_is_learned_is_the_same_on_any_number_of_threads(torch_threads):
    demonstrations = list(np.array(Demonstrations.load("DoubleSidedPlacement").configurations))
    learned = []
    for threads in (1, 2, 4):
        torch_threads(threads)
        several = learn_prior(demonstrations, PriorSettings()).components()
        several = [
            *several,
            ProMP.fit(demonstrations),
            *ProMPMixture.fit(demonstrations).components,
        ]
        learned.append([part for each in several for part in (each.mean, each.factor, each.noise)])
        assert torch.get_num_threads() == threads
    for other in learned[1:]:
        assert all(torch.equal(one, two) for one, two in zip(learned[0], other, strict=True))


def test_a_plan_is_the_same_on_any_number_of_threads(torch_threads):
    circle = Circle((0.5, 0.5), 0.1)
    phase = np.linspace(0.0, 1.0, 100)
    demonstrations = [np.stack([phase, phase + 0.02 * k * phase], axis=1) for k in range(5)]
    plans = []
    for threads in (1, 2, 4):
        torch_threads(threads)
        plans.append(SMP.fit(demonstrations).adapt([circle], particles=8))
    for plan in plans[1:]:
        np.testing.assert_array_equal(plan.trajectories, plans[0].trajectories)
        np.testing.assert_array_equal(plan.weights, plans[0].weights)


@pytest.mark.parametrize("task", TASKS)
def test_every_planner_plans_the_same_on_any_number_of_threads(task, torch_threads, monkeypatch):
    """What it learns included; the slowest planner, which is a `cpromp`, for one task alone."""
    (problem,) = posed([sample_scene(task, "easy", 2)])
    slow = {"cpromp_chance"} if task != "Placement" else set()
    names = [name for name in planners_of(task) if name not in {"rrt_connect", *slow}]
    plans = []
    for threads in (1, 3):
        torch_threads(threads)
        monkeypatch.setattr(pipeline, "default_threads", torch.get_num_threads)
        plans.append([make_planner(name, task).plan([problem])[0] for name in names])
    for others in plans[1:]:
        for name, one, other in zip(names, plans[0], others, strict=True):
            for part in ("trajectories", "weights", "clearance", "passing", "ranks"):
                np.testing.assert_array_equal(getattr(one, part), getattr(other, part), name)
            assert one.chosen == other.chosen
            assert len(one.trajectories)
