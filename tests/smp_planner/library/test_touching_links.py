"""Pairs of links that may touch: from SRDFs and by name, kept in files, named in warnings."""

import logging
from pathlib import Path

import numpy as np
import pybullet_data
import pytest

from smp_planner import SMP, Robot
from smp_planner.library.semantic_description import read_touching

KUKA = f"{pybullet_data.getDataPath()}/kuka_iiwa/model.urdf"
LINKS = [f"lbr_iiwa_link_{number}" for number in range(8)]

SRDF = """<?xml version="1.0"?>
<robot name="lbr_iiwa">
  <group name="arm"><chain base_link="lbr_iiwa_link_0" tip_link="lbr_iiwa_link_7"/></group>
  <disable_collisions link1="lbr_iiwa_link_0" link2="lbr_iiwa_link_2" reason="Never"/>
  <disable_collisions link1="lbr_iiwa_link_6" link2="lbr_iiwa_link_4" reason="Never"/>
  {more}
</robot>
"""


def written(tmp_path, more="", text=SRDF):
    path = tmp_path / "arm.srdf"
    path.write_text(text.format(more=more))
    return path


def paired(robot, model):
    """Return the pairs of links of which spheres are kept apart."""
    bodies = np.array(robot.bodies)[model.collision_pairs]
    return {frozenset(pair) for pair in bodies.tolist()}


@pytest.fixture(scope="module")
def demonstrations():
    start = np.array([-0.8, 0.5, 0.0, -1.4, 0.0, 1.2, 0.0])
    rng = np.random.default_rng(0)
    share = np.linspace(0.0, 1.0, 60)[:, None]
    return [
        start + share * np.array([1.6, 0, 0, 0, 0, 0, 0]) + rng.normal(0.0, 0.02, 7)
        for _ in range(4)
    ]


def test_disabled_pairs_are_not_kept_apart(tmp_path, demonstrations):
    plain = Robot.from_urdf(KUKA, LINKS[7], overshoot=0.04)
    assert set(plain.bodies) == set(LINKS)
    assert len(plain.bodies) == len(plain.model.link)
    told = Robot.from_urdf(
        KUKA,
        LINKS[7],
        overshoot=0.04,
        srdf=written(tmp_path),
        touching=[(LINKS[7], LINKS[0])],
    )
    disabled = {
        frozenset((LINKS[0], LINKS[2])),
        frozenset((LINKS[4], LINKS[6])),
        frozenset((LINKS[0], LINKS[7])),
    }
    assert told.touching == disabled
    before, after = (
        paired(robot, SMP.fit(demonstrations, robot=robot).robot.model) for robot in (plain, told)
    )
    assert after == before - disabled
    assert frozenset((LINKS[0], LINKS[7])) in before


def test_defaults_of_a_link_are_disabled_but_for_those_enabled(tmp_path):
    more = (
        f'<disable_default_collisions link="{LINKS[1]}"/>'
        f'<enable_collisions link1="{LINKS[1]}" link2="{LINKS[7]}"/>'
    )
    found = read_touching(written(tmp_path, more), set(LINKS))
    with_first = {pair for pair in found if LINKS[1] in pair}
    assert with_first == {frozenset((LINKS[1], other)) for other in LINKS if other != LINKS[7]}
    assert frozenset((LINKS[0], LINKS[2])) in found


def test_files_keep_them(tmp_path, demonstrations):
    robot = Robot.from_urdf(KUKA, LINKS[7], overshoot=0.04, srdf=written(tmp_path))
    primitive = SMP.fit(demonstrations, robot=robot)
    primitive.save(tmp_path / "swing.npz")
    again = SMP.load(tmp_path / "swing.npz").robot
    assert again.bodies == robot.bodies
    assert again.touching == robot.touching
    np.testing.assert_array_equal(
        again.model.collision_pairs, primitive.robot.model.collision_pairs
    )


def test_warnings_name_links_unless_they_may_touch(demonstrations, caplog):
    folded = [d + np.array([0.0, 0.0, 0.0, -0.65, 0.0, 0.85, 0.0]) for d in demonstrations]
    robot = Robot.from_urdf(KUKA, LINKS[7], overshoot=0.06)
    with caplog.at_level(logging.WARNING, "smp_planner.library.collision_pairs"):
        SMP.fit(folded, robot=robot)
    named = {tuple(sorted((r.args[0], r.args[1]))) for r in caplog.records}
    assert named
    assert {name for pair in named for name in pair} <= set(LINKS)
    caplog.clear()
    told = Robot.from_urdf(KUKA, LINKS[7], overshoot=0.06, touching=named)
    with caplog.at_level(logging.WARNING, "smp_planner.library.collision_pairs"):
        SMP.fit(folded, robot=told)
    assert not caplog.records


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<sdf/>", "is not an SRDF: its root is <sdf>"),
        ("<robot", "is not an SRDF"),
        ('<!DOCTYPE x [<!ENTITY a "b">]><robot/>', "declares entities"),
        ('<robot><disable_collisions link1="wrist"/></robot>', "must be a link .* 'wrist'"),
        (f'<robot><disable_collisions link1="{LINKS[0]}"/></robot>', "link2 of .* got None"),
        ('<robot><disable_default_collisions link="x"/></robot>', "must be a link .* 'x'"),
        (Path(KUKA).read_text(), "is not an SRDF: it holds a <link>, as a URDF does"),
        ('<robot><joint name="j" type="fixed"/></robot>', "is not an SRDF: it holds a <joint>"),
    ],
)
def test_files_that_are_no_srdf_of_the_robot_are_refused(tmp_path, text, message):
    path = tmp_path / "arm.srdf"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        Robot.from_urdf(KUKA, LINKS[7], srdf=path)


@pytest.mark.parametrize(
    ("touching", "message"),
    [
        ("ab", "must be pairs of names"),
        (3, "must be pairs of names"),
        ([("a",)], r"touching\[0\] must be two names"),
        ([(LINKS[0], 3)], r"touching\[0\] must be two names"),
        ([LINKS[0]], r"touching\[0\] must be two names"),
        ([(LINKS[0], "wrist")], r"touching\[0\] names the link 'wrist'"),
    ],
)
def test_pairs_that_are_none_are_refused(touching, message):
    with pytest.raises(ValueError, match=message):
        Robot.from_urdf(KUKA, LINKS[7], touching=touching)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.srdf"):
        Robot.from_urdf(KUKA, LINKS[7], srdf=tmp_path / "none.srdf")
