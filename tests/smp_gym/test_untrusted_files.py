"""Files that are damaged or made to harm: refused by name, in a moment and without their memory."""

import gzip
import io
import json
import tracemalloc
import zipfile
import zlib

import numpy as np
import pytest

from smp_gym.datasets import frozen
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.datasets.motion_bench_maker import load_obstacles
from smp_gym.suites import SUITES
from smp_gym.untrusted_files import parse_json, parse_yaml, read_arrays, unzipped
from smp_planner.library.reading import demonstrations_of
from smp_planner.library.smp import SMP
from smp_planner.occupancy.neural import PointNetwork
from smp_planner.occupancy.shape_networks import ShapeNetworks
from smp_planner.policy.policy_file import SavedPolicy, read_policy, write_policy

DEEP = "[" * 100_000
LITTLE = 2**24


def npz(**members):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return file.getvalue()


def npy(shape, dtype="<f8", body=b""):
    text = f"{{'descr': {dtype!r}, 'fortran_order': False, 'shape': {shape!r}, }}"
    header = text.ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + body


def lying(true, announced):
    """Return an archive that unpacks to other than it announces."""
    whole = npz(demonstrations=b"\0" * true)
    return whole.replace(true.to_bytes(4, "little"), announced.to_bytes(4, "little"))


BOMBS = {
    "empty": b"",
    "text": b"no archive",
    "a zip of gigabytes": lying(1000, 2**31 - 1),
    "a zip that lies": lying(2 * 10**7, 100),
    "an array of terabytes": npz(demonstrations=npy((10**6, 10**6))),
    "an array of objects": npz(demonstrations=npy((1,), "|O", b"\x80\x04N.")),
    "complex numbers": npz(demonstrations=npy((1,), "<c16", bytes(16))),
    "a header that is deep": npz(demonstrations=npy(DEEP[:60_000])),
    "a torn array": npz(demonstrations=npy((4,), body=bytes(31))),
    "a folder": npz(**{"a/": b""}),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Whole files of each kind, with what reads them."""
    folder = tmp_path_factory.mktemp("files")
    shown = Demonstrations.load("Placement")
    shown.save(folder / "shown.npz")
    write_policy(folder / "policy.zip", SavedPolicy("promp", {}, 0, shown))
    ramp = np.linspace([0.0, 0.0], [1.0, 1.0], 10)
    SMP.fit([ramp, ramp * [1.0, 0.5]]).save(folder / "primitive.npz")
    np.savez_compressed(folder / "paths.npz", demonstrations=np.array([ramp, ramp]))
    return {
        folder / "shown.npz": Demonstrations.load,
        folder / "policy.zip": read_policy,
        folder / "primitive.npz": SMP.load,
        folder / "paths.npz": demonstrations_of,
        folder / "network.npz": PointNetwork.load,
        folder / "networks.npz": ShapeNetworks.load,
    }


@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS)
def test_bombs_are_refused_by_all_readers(files, bomb, tmp_path):
    for path, read in files.items():
        bad = tmp_path / path.name
        bad.write_bytes(bomb)
        tracemalloc.start()
        with pytest.raises(ValueError, match=path.name):
            read(bad)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < LITTLE


def test_damaged_bytes_are_refused_or_change_nothing_else(files, tmp_path):
    rng = np.random.default_rng(0)
    for path, read in files.items():
        if not path.exists():
            continue
        whole, complaints = path.read_bytes(), list[str]()
        for number in range(40):
            content = bytearray(whole)
            if number % 4 == 0:
                content = content[: rng.integers(len(whole))]
            else:
                for place in rng.integers(len(whole), size=number % 4):
                    content[place] ^= 1 << rng.integers(8)
            bad = tmp_path / path.name
            bad.write_bytes(content)
            try:
                read(bad)
            except ValueError as error:
                complaints.append(str(error))
        assert all(path.name in complaint for complaint in complaints)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ({}, "must be a saved policy"),
        ([], "must be a saved policy"),
        ({"method": None}, "its method must be a str, got None"),
        ({"settings": []}, "its settings must be a dict"),
        ({"seed": "0"}, "its seed must be a int"),
        (DEEP, "policy.json, is not JSON"),
        ('{"a": NaN}', "numbers must be finite"),
        ("\xff", "policy.json, is not JSON"),
    ],
)
def test_policies_with_other_headers_are_refused(files, tmp_path, header, message):
    whole = next(path for path in files if path.name == "policy.zip")
    with zipfile.ZipFile(whole) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    if isinstance(header, dict) and header:
        header = json.loads(members["policy.json"]) | header
    text = header if isinstance(header, str) else json.dumps(header)
    members["policy.json"] = text.encode("latin-1")
    with zipfile.ZipFile(tmp_path / "policy.zip", "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    with pytest.raises(ValueError, match=message):
        read_policy(tmp_path / "policy.zip")


@pytest.mark.parametrize(
    "text",
    [DEEP, '{"a":' * 5000, '{"a": 1, "a": 2}', "[NaN]", "[1e999]", "[" + "9" * 5000 + "]", "", "x"],
)
def test_json_that_cannot_be_meant(text):
    with pytest.raises(ValueError, match="mine is not JSON"):
        parse_json(text, "mine")
    assert parse_json('{"a": [1, 2.5, null]}', "mine") == {"a": [1, 2.5, None]}


ALIASES = "a: &a [x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join(['*' + a] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    "text",
    [
        ALIASES,
        DEEP,
        "a: " * 1000,
        "- " * 1000 + "a",
        "!!python/object/apply:os.getcwd []",
        "!!timestamp a",
        "!!int x",
        "? [a]\n: b",
        "world: \xff",
        "x" * 2**21,
    ],
)
def test_yaml_that_cannot_be_meant(text, tmp_path):
    pytest.importorskip("yaml")
    with pytest.raises(ValueError, match="mine is not YAML"):
        parse_yaml(text.encode("latin-1"), "mine")
    (tmp_path / "scene.yaml").write_bytes(text.encode("latin-1"))
    with pytest.raises(ValueError, match=r"scene.yaml is no scene"):
        load_obstacles(tmp_path / "scene.yaml")


ONE = '{"format": "smp_gym.episodes", "version": 2, "episodes": 1, "unknown": 0}\n'


def packed(text):
    return gzip.compress(text if isinstance(text, bytes) else text.encode(), mtime=0)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"text",
        packed("")[:-4],
        packed(""),
        packed("[]"),
        packed(DEEP),
        packed(ONE.replace("1", '"1"') + "{}"),
        packed(ONE + "[]"),
        packed(ONE + DEEP),
        packed(b"\xff\xfe"),
        packed(b"\0" * 7 * 10**7),
    ],
)
def test_lists_of_episodes_are_refused(content, tmp_path):
    cell = SUITES["standard"][0]
    path = frozen.list_path(cell, tmp_path)
    path.parent.mkdir()
    path.write_bytes(content)
    with pytest.raises(ValueError, match=path.name):
        frozen.load_episodes(cell, tmp_path)


def test_gzipped_files_end_where_they_say():
    whole = gzip.compress(b"one") + gzip.compress(b"two")
    assert unzipped(whole, "mine") == b"onetwo"
    for bad in (whole[:-1], whole + b"x", zlib.compress(b"one")):
        with pytest.raises(ValueError, match="mine is damaged"):
            unzipped(bad, "mine")
    with pytest.raises(ValueError, match="more than 5 bytes"):
        unzipped(whole, "mine", largest=5)


def test_arrays_come_back_as_they_were():
    file = io.BytesIO()
    arrays = {"a": np.arange(6.0).reshape(2, 3).T, "b": np.array("text"), "c": np.zeros((0, 2))}
    np.savez_compressed(file, **arrays)
    for name, array in read_arrays(file.getvalue(), "mine").items():
        np.testing.assert_array_equal(array, arrays[name])
