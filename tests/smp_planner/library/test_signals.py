"""What demonstrations recorded beside coordinates: read, kept by phase, and carried to a motion."""

import json

import numpy as np
import pytest

from smp_planner.library.smp import SMP, Robot
from smp_planner.planning.plan import Plan

JOINTS = ("shoulder", "elbow")
SAMPLES = 41
SWITCHES = (0.25, 0.3, 0.35)
DURATIONS = (2.0, 2.5, 3.0)


@pytest.fixture(scope="module")
def arm(planar):
    return Robot(planar, JOINTS)


def swing(number, phase):
    """Return a swing of the joints (T, 2) rad."""
    return np.stack([phase - 0.5, (0.4 + 0.05 * number) * np.sin(np.pi * phase)], axis=1)


def opening(number, phase):
    """Return the opening of a gripper (T,) m."""
    return 0.08 - (0.05 + 0.01 * number) * phase**2


def table(times=lambda phase: phase, header="time,light,elbow,opening,shoulder", number=0):
    """Return a demonstration whose light is switched on and, at 0.75, off."""
    # The times of the samples are bent: the phase is that of the time, not the sample's number.
    phase = np.linspace(0.0, 1.0, SAMPLES)
    path = swing(number, phase)
    light = (phase >= SWITCHES[number]) & (phase < 0.75)
    stamps = 100.0 + DURATIONS[number] * times(phase)
    columns = [stamps, light, path[:, 1], opening(number, phase), path[:, 0]]
    rows = [",".join(repr(float(x)) for x in row) for row in zip(*columns, strict=True)]
    return "\n".join([header, *rows]) + "\n"


@pytest.fixture
def files(tmp_path):
    for number in range(3):
        (tmp_path / f"{number}.csv").write_text(table(number=number))
    return [tmp_path / f"{number}.csv" for number in range(3)]


def test_columns_become_functions_of_phase(arm, files):
    primitive = SMP.fit(files, robot=arm, signals=["opening", "light"])
    phase = np.linspace(0.0, 1.0, SAMPLES)
    for number, demonstration in enumerate(primitive.demonstrations):
        np.testing.assert_allclose(demonstration, swing(number, phase), atol=1e-12)
    np.testing.assert_allclose(primitive.durations, DURATIONS)
    assert list(primitive.signals) == ["opening", "light"]
    at = np.linspace(0.0, 1.0, 1000)
    mean = np.mean([opening(number, at) for number in range(3)], axis=0)
    np.testing.assert_allclose(primitive.signals["opening"](at), mean, atol=1e-4)
    light = primitive.signals["light"]
    assert light.switches
    assert not primitive.signals["opening"].switches
    np.testing.assert_allclose(light.phases, [0.0, np.mean(SWITCHES), 0.75])
    np.testing.assert_array_equal(
        light(np.array([0.0, 0.29, 0.31, 0.74, 0.76, 1.0])), [0, 0, 1, 1, 0, 0]
    )


def test_phases_are_those_of_the_times(arm, tmp_path):
    """Samples at uneven times: the light goes on at the square of the phases that are written."""
    for number in range(3):
        (tmp_path / f"{number}.csv").write_text(table(lambda phase: phase**2, number=number))
    files = [tmp_path / f"{number}.csv" for number in range(3)]
    light = SMP.fit(files, robot=arm, signals=["opening", "light"]).signals["light"]
    np.testing.assert_allclose(light.phases, [0.0, np.mean(np.square(SWITCHES)), 0.75**2])


def test_arrays_take_signals_by_name(arm):
    phase = np.linspace(0.0, 1.0, SAMPLES)
    paths = [swing(number, phase[: SAMPLES - number]) for number in range(3)]
    force = [np.full(len(path), 1.0 + number) for number, path in enumerate(paths)]
    primitive = SMP.fit(paths, robot=arm, signals={"force": force}, durations=DURATIONS)
    np.testing.assert_allclose(primitive.signals["force"](phase), 2.0)
    np.testing.assert_array_equal(primitive.durations, DURATIONS)
    assert SMP.fit(paths, robot=arm).durations is None


def test_a_saved_primitive_keeps_them(arm, files, tmp_path):
    primitive = SMP.fit(files, robot=arm, signals=["light", "opening"])
    primitive.save(tmp_path / "arm.npz")
    again = SMP.load(tmp_path / "arm.npz")
    np.testing.assert_array_equal(again.durations, primitive.durations)
    at = np.linspace(0.0, 1.0, 77)
    assert list(again.signals) == ["light", "opening"]
    for name, signal in primitive.signals.items():
        np.testing.assert_array_equal(again.signals[name](at), signal(at))
    with np.load(tmp_path / "arm.npz") as archive:
        arrays = dict(archive)
    for changed in ({"signal_values": np.zeros((2, 3))}, {"durations": np.zeros((3, 1))}):
        np.savez(tmp_path / "damaged.npz", **arrays | changed)
        with pytest.raises(ValueError, match=r"damaged.npz is damaged"):
            SMP.load(tmp_path / "damaged.npz")


def test_they_go_with_a_plan_to_a_motion_and_its_files(arm, files, tmp_path):
    primitive = SMP.fit(files, robot=arm, signals=["opening", "light"], smooth_std=0.02)
    plan = primitive.adapt(particles=4, method="promp")
    assert isinstance(plan, Plan)
    motion = arm.timed(plan.best, 2.0, signals=plan.signals)
    # Where the motion is on the path says its phase: the shoulder goes on all the time.
    assert (np.diff(plan.best[:, 0]) > 0.0).all()
    phases = np.interp(motion.positions[:, 0], plan.best[:, 0], np.linspace(0.0, 1.0, 200))
    np.testing.assert_allclose(motion.phases, phases, atol=2e-3)
    mean = np.mean([opening(number, motion.phases) for number in range(3)], axis=0)
    np.testing.assert_allclose(motion.signals["opening"], mean, atol=1e-4)
    assert [(event.name, event.value) for event in motion.events] == [
        ("light", 1.0),
        ("light", 0.0),
    ]
    for event, phase in zip(motion.events, (np.mean(SWITCHES), 0.75), strict=True):
        assert np.interp(event.time, motion.times, motion.phases) == pytest.approx(phase, abs=1e-3)
        # The sample before has the other value.
        after = np.searchsorted(motion.times, event.time)
        assert motion.signals["light"][after] == event.value != motion.signals["light"][after - 1]

    motion.save(tmp_path / "motion.csv")
    read = np.genfromtxt(tmp_path / "motion.csv", delimiter=",", names=True, deletechars="")
    assert read.dtype.names[-2:] == ("signal:opening", "signal:light")
    np.testing.assert_allclose(read["signal:opening"], motion.signals["opening"], atol=1e-9)
    motion.save(tmp_path / "motion.json")
    content = json.loads((tmp_path / "motion.json").read_text())
    assert content["joint_names"] == list(JOINTS)
    assert set(content["points"][0]) == {
        "positions",
        "velocities",
        "accelerations",
        "effort",
        "time_from_start",
    }
    assert content["signals"]["light"] == motion.signals["light"].tolist()
    assert content["events"][1] == {"time": motion.events[1].time, "name": "light", "value": 0.0}
    assert set(motion.joint_trajectory()) == {"joint_names", "points"}


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        ("opening", "signals must be names of columns, .* got 'opening'"),
        ([3], r"signals must be names of columns, .* got \[3\]"),
        (["opening"], r"column 'light', which is none of the joints .*signals=\['light'\]"),
        (["opening", "light", "force"], "line 1 must have a column for each signal.*'force'"),
        (["opening", "light", "elbow"], "none of the joints, got 'elbow'"),
        (["opening", "opening"], "must be different, .* got 'opening'"),
        ({"force": [[1.0]]}, r"signals\['force'\] must hold numbers of 3 demonstrations"),
        ({"force": [[1.0]] * 3}, r"signals\['force'\]\[0\] must have shape \(41,\)"),
    ],
)
def test_signals_that_cannot_be_meant_are_named(arm, files, signals, message):
    if isinstance(signals, dict):
        for number, file in enumerate(files):
            np.savetxt(file, swing(number, np.linspace(0, 1, SAMPLES)), delimiter=",", header="a,b")
    with pytest.raises(ValueError, match=message):
        SMP.fit(files, robot=arm, signals=signals)


def test_faults_of_signals_are_named(arm, files):
    phase = np.linspace(0.0, 1.0, SAMPLES)
    paths = [swing(number, phase) for number in range(3)]
    with pytest.raises(ValueError, match=r"signals of arrays must map .*signals=\{'light'"):
        SMP.fit(paths, robot=arm, signals=["light"])
    for durations in ([1.0, 2.0], [1.0, 2.0, 0.0]):
        with pytest.raises(ValueError, match="durations must"):
            SMP.fit(paths, robot=arm, durations=durations)
    files[1].write_text(table(number=1).replace(",1.0,", ",0.0,"))
    with pytest.raises(ValueError, match=r"'light' must switch alike .*\[0.0\] in .*\[1\]"):
        SMP.fit(files, robot=arm, signals=["opening", "light"])
    files[1].write_text(table(number=1).replace(",1.0,", ",nan,", 1))
    with pytest.raises(ValueError, match=r"1.csv, line \d+, column 'light' .* finite .*got nan$"):
        SMP.fit(files, robot=arm, signals=["opening", "light"], nan_is_missing=True)
    with pytest.raises(ValueError, match="signals must map names to Signals"):
        arm.timed(paths[0], 2.0, signals={"light": 3.0})


def test_an_npz_file_has_no_columns(arm, tmp_path):
    phase = np.linspace(0.0, 1.0, SAMPLES)
    np.savez(tmp_path / "a.npz", demonstrations=np.array([swing(n, phase) for n in range(3)]))
    with pytest.raises(ValueError, match=r"a.npz: signals of .npz files must map names"):
        SMP.fit(tmp_path / "a.npz", robot=arm, signals=["light"])
    force = [phase] * 3
    primitive = SMP.fit(tmp_path / "a.npz", robot=arm, signals={"force": force})
    np.testing.assert_allclose(primitive.signals["force"](phase), phase, atol=1e-12)
