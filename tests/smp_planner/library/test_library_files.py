"""Demonstrations and primitives in files."""

import numpy as np
import pytest

from smp_gym.datasets.demonstrations import Demonstrations
from smp_planner.adaptation import adaptation
from smp_planner.library.reading import demonstrations_of
from smp_planner.library.smp import SMP, Circle

PHASE = np.linspace(0.0, 1.0, 40)[:, None]
PATHS = [np.hstack([PHASE, a * np.sin(np.pi * PHASE)]) for a in (0.8, 1.0, 1.1)]


def refused(path, content, message):
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message):
        demonstrations_of(path)


def test_arrays_in_a_file(tmp_path):
    np.savez(tmp_path / "one.npz", demonstrations=np.array(PATHS))
    np.testing.assert_array_equal(demonstrations_of(tmp_path / "one.npz"), PATHS)
    uneven = {f"demonstration_{i}": path[: 20 + i] for i, path in enumerate(PATHS)}
    np.savez(tmp_path / "several.npz", **dict(reversed(uneven.items())))
    several = demonstrations_of(str(tmp_path / "several.npz"))
    for found, path in zip(several, uneven.values(), strict=True):
        np.testing.assert_array_equal(found, path)
    recorded = Demonstrations.load("DrawS")
    recorded.save(tmp_path / "recorded.npz")
    found = demonstrations_of(tmp_path / "recorded.npz")
    np.testing.assert_array_equal(found, recorded.configurations)


def test_files_that_hold_something_else_are_refused(tmp_path):
    np.savez(tmp_path / "other.npz", paths=np.array(PATHS))
    with pytest.raises(ValueError, match=r"must hold an array 'demonstrations' .* got paths"):
        demonstrations_of(tmp_path / "other.npz")
    np.savez(tmp_path / "pickled.npz", demonstrations=np.array([{}, {}], dtype=object))
    with pytest.raises(ValueError, match=r"pickled.npz, .* got object"):
        demonstrations_of(tmp_path / "pickled.npz")
    whole = (tmp_path / "other.npz").read_bytes()
    for content in (b"", b"text", whole[: len(whole) // 2]):
        refused(tmp_path / "damaged.npz", content, r"damaged.npz is damaged")
    with pytest.raises(ValueError, match=r"\.npz or \.csv files, got 'paths.mat'"):
        demonstrations_of("paths.mat")
    with pytest.raises(FileNotFoundError):
        demonstrations_of(tmp_path / "none.csv")


def test_tables_of_samples(tmp_path):
    lines = ["x,demonstration,y"]
    for name, path in zip("bac", PATHS, strict=True):
        lines += [f"{x!r},{name},{y!r}" for x, y in path.tolist()]
    (tmp_path / "table.csv").write_text("\n".join(lines))
    found = demonstrations_of(tmp_path / "table.csv")
    np.testing.assert_array_equal(found, PATHS)


def test_times_make_steps_equal(tmp_path):
    times = np.linspace(0.0, 1.0, 41) ** 2
    lines = ["demonstration,time,x,y"]
    for name, speed in (("slow", 1.0), ("fast", 3.0)):
        lines += [f"{name},{5.0 + t / speed!r},{2.0 * t!r},{-t!r}" for t in times.tolist()]
    (tmp_path / "timed.csv").write_text("\n".join(lines))
    line = np.linspace(0.0, 1.0, 41)
    for found in demonstrations_of(tmp_path / "timed.csv"):
        np.testing.assert_allclose(found, np.stack([2.0 * line, -line], axis=1), atol=1e-12)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "must have the columns demonstration, time .* got none"),
        (b"x,y\n1,2\n", "must have the columns .* got x, y"),
        (b"demonstration,time\na,1\n", "must have the columns"),
        (b"demonstration,x\na,1,2\n", "line 2 must have 2 entries, got 3"),
        (b"demonstration,x\na,1\na,one\n", "line 3, column 'x' must hold numbers"),
        (b"demonstration,time,x\na,1,0\na,1,1\n", "times of demonstration 'a' must rise"),
        (b"demonstration,x\na,1\na,2\n", "at least 2, got 1"),
    ],
)
def test_bad_tables_are_named(tmp_path, content, message):
    refused(tmp_path / "table.csv", content, message)


def test_a_primitive_comes_back_as_it_was(tmp_path):
    primitive = SMP.fit([PATHS[0][::2], *PATHS[1:]], smooth_std=0.07, basis_functions=10)
    primitive.save(tmp_path / "primitive.npz")
    again = SMP.load(tmp_path / "primitive.npz")
    assert again.settings == primitive.settings
    method, obstacles = adaptation("smp", iterations=10), [Circle((0.5, 0.9), 0.1)]
    plans = [p.adapt(obstacles, method=method, particles=7) for p in (primitive, again)]
    np.testing.assert_array_equal(plans[0].trajectories, plans[1].trajectories)


def test_files_of_primitives_that_are_damaged_or_other_are_refused(tmp_path):
    path = tmp_path / "primitive.npz"
    SMP.fit(PATHS).save(path)
    whole = path.read_bytes()
    with np.load(path) as archive:
        arrays = dict(archive)
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 0xFF
    for content in (b"", whole[:-30], bytes(flipped)):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"primitive.npz is damaged"):
            SMP.load(path)
    for name, value in (
        ("lengths", np.array([1, 2])),
        ("samples", np.zeros(120)),
        ("settings", np.array('{"smooth_std": -1}')),
        ("samples", None),
    ):
        changed = arrays | {name: value}
        np.savez(path, **{key: item for key, item in changed.items() if item is not None})
        with pytest.raises(ValueError, match=r"primitive.npz is damaged"):
            SMP.load(path)
    np.savez(path, **arrays | {"header": np.array('{"format": "other", "version": 1}')})
    with pytest.raises(ValueError, match="must have the header"):
        SMP.load(path)
    with pytest.raises(FileNotFoundError):
        SMP.load(tmp_path / "none.npz")


def test_a_list_of_files_with_a_demonstration_each(tmp_path):
    """As loggers write them: without a column that tells demonstrations apart."""
    paths = [np.random.default_rng(n).normal(size=(30, 2)).cumsum(axis=0) for n in range(4)]
    for n, path in enumerate(paths[:3]):
        np.savetxt(tmp_path / f"{n}.csv", path, delimiter=",", header="x,y", comments="")
    np.savez(tmp_path / "3.npz", demonstrations=np.array([paths[3]]))
    files = [tmp_path / "0.csv", str(tmp_path / "1.csv"), tmp_path / "2.csv", tmp_path / "3.npz"]
    read = demonstrations_of(files)
    assert len(read) == 4
    for given, found in zip(paths, read, strict=True):
        np.testing.assert_allclose(found, given, atol=1e-12)


def test_faults_of_one_file_among_several_are_named(tmp_path):
    good = tmp_path / "good.csv"
    good.write_text("x,y\n0,1\n1,2\n")
    with pytest.raises(ValueError, match=r"good\.csv must have the columns demonstration.*a list"):
        demonstrations_of(good)
    torn = tmp_path / "torn.csv"
    torn.write_text("x,y\n0,1\n1\n")
    with pytest.raises(ValueError, match=r"torn\.csv, line 3 must have 2 entries, got 1"):
        demonstrations_of([good, torn])
    with pytest.raises(ValueError, match=r"demonstrations\[1\] must be a file as others"):
        demonstrations_of([good, np.zeros((3, 2))])
    with pytest.raises(ValueError, match=r"must be \.npz or \.csv files, got .*notes\.txt"):
        demonstrations_of([good, tmp_path / "notes.txt"])
    wide = tmp_path / "wide.csv"
    wide.write_text("x,y,z\n0,1,2\n1,2,3\n")
    with pytest.raises(ValueError, match=r"wide\.csv"):
        demonstrations_of([good, wide])
    with pytest.raises(FileNotFoundError):
        demonstrations_of([good, tmp_path / "none.csv"])
