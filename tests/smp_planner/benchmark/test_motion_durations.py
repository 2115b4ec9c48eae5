"""Durations with limits of jerk: one profile against what is known of a line, and the order."""

import numpy as np
import pytest

from smp_planner.benchmark.motion_durations import (
    durations_table,
    least_of_one_profile,
    motion_durations,
)
from smp_planner.library.joint_path import JointPath


def test_one_profile_along_a_line_is_the_fastest_there():
    path = JointPath(np.linspace(0.0, 1.0, 50)[:, None] * [0.0, 1.6], 2)
    least = least_of_one_profile(path, np.array([1.5, 0.8]), 2.0, 10.0)
    # At the greatest speed, with the gain of it: d/v + v/a + a/j.
    assert least == pytest.approx(1.6 / 0.8 + 0.8 / 2.0 + 2.0 / 10.0, rel=1e-9)


def test_limits_of_jerk_cost_some_time_and_one_profile_costs_more():
    found = motion_durations(["Placement"], 1, 2.0, [20.0, 200.0], seed=0)
    assert [each.jerk for each in found] == [20.0, 200.0]
    for each in found:
        assert each.unlimited < each.smooth < 1.1 * each.unlimited < each.one_profile
    assert found[1].smooth < found[0].smooth
    assert found[1].one_profile < found[0].one_profile
    rows = durations_table(found).splitlines()
    assert [row.split("|")[1].strip() for row in rows[2:]] == ["20", "200"]


@pytest.mark.parametrize(("acceleration", "jerk"), [(0.0, 1.0), (1.0, -1.0)])
def test_limits_must_be_above_0(acceleration, jerk):
    with pytest.raises(ValueError, match=r"(acceleration|jerk) must be .* above 0"):
        motion_durations(["Placement"], 1, acceleration, [jerk], seed=0)
