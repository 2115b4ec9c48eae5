"""Tables of demonstrations as people have them: read by name, or refused by place."""

import numpy as np
import pytest

from smp_planner.library.reading import demonstrations_of

PHASE = np.linspace(0.0, 1.0, 6)
JOINTS = ("shoulder", "elbow", "wrist")
PATHS = [np.stack([PHASE, height * PHASE**2, 3.0 - PHASE], 1) for height in (0.5, 1.0)]


def table(names=("demonstration", "time", "x", "y", "z"), order=(0, 1, 2), stamp=lambda t: t):
    lines = [",".join(names)]
    for number, path in enumerate(PATHS):
        for t, point in zip(PHASE, path, strict=True):
            cells = [f"d{number}", repr(float(stamp(t)))] if "time" in names else [f"d{number}"]
            lines.append(",".join([*cells, *(repr(float(point[k])) for k in order)]))
    return "\n".join(lines) + "\n"


def read(folder, content, joints=None, **options):
    path = folder / "logs.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return demonstrations_of(path, joints, **options)


def german(text):
    return text.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbf" + table().encode(),
        table().encode("utf-16"),
        table().replace(",", ";"),
        german(table()),
        table().replace(",", "\t"),
        table().replace("\n", "\r\n"),
        table().replace("\n", "\n  \n"),
        table(("Demonstration", "time", "x", "y", "z")),
        table().replace("time", "Timestamp"),
        table(stamp=lambda t: 1.7e9 + t),
    ],
)
def test_dialects_are_read_alike(tmp_path, content):
    for found, path in zip(read(tmp_path, content), PATHS, strict=True):
        np.testing.assert_allclose(found, path, atol=1e-6)


@pytest.mark.parametrize("order", [(2, 0, 1), (1, 0, 2), (2, 1, 0)])
def test_columns_of_joints_are_read_by_name(tmp_path, order):
    names = ("demonstration", "time", *(JOINTS[k] for k in order))
    for found, path in zip(read(tmp_path, table(names, order), JOINTS), PATHS, strict=True):
        np.testing.assert_allclose(found, path, atol=1e-12)


def test_columns_with_names_of_their_own_are_read_as_they_stand(tmp_path):
    names = ("demonstration", "time", "q1", "q2", "q3")
    for found, path in zip(read(tmp_path, table(names), JOINTS), PATHS, strict=True):
        np.testing.assert_allclose(found, path, atol=1e-12)


UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
PANDA = tuple(f"panda_joint{number}" for number in (1, 2, 3))


@pytest.mark.parametrize(
    ("joints", "names"),
    [
        (UR, ("shoulder_pan", "shoulder_lift", "elbow")),
        (UR, ("Shoulder_Pan_Joint", "Shoulder_Lift_Joint", "Elbow_Joint")),
        (UR, ("PAN", "LIFT", "ELBOW")),
        (UR, ("q1", "q2", "q3")),
        (UR, ("q8", "q9", "q10")),
        (PANDA, ("joint1", "joint2", "joint3")),
        (PANDA, ("joint_1", "joint_2", "joint_3")),
        (("joint_12", "joint_1", "joint_2"), ("Joint12", "Joint1", "Joint2")),
    ],
)
def test_parts_of_names_say_which_order_is_meant(tmp_path, joints, names):
    columns = ("demonstration", "time")
    for found, path in zip(read(tmp_path, table((*columns, *names)), joints), PATHS, strict=True):
        np.testing.assert_allclose(found, path, atol=1e-12)
    for order in ((2, 1, 0), (0, 2, 1), (1, 2, 0)):
        content = table((*columns, *(names[k] for k in order)), order)
        with pytest.raises(ValueError, match=r"line 1 must call columns as the joints .*; got '"):
            read(tmp_path, content, joints)


@pytest.mark.parametrize("order", [(2, 1, 0), (1, 0, 2)])
@pytest.mark.parametrize("names", ["xyz", "XYZ"])
def test_axes_are_read_by_name(tmp_path, names, order):
    content = table(("demonstration", "time", *(names[k] for k in order)), order)
    for found, path in zip(read(tmp_path, content), PATHS, strict=True):
        np.testing.assert_allclose(found, path, atol=1e-12)


@pytest.mark.parametrize(
    ("content", "joints", "message"),
    [
        (table(("demonstration", "time", "elbow", "wrist", "z")), JOINTS, "none for 'shoulder'"),
        (
            table(("demonstration", "time", "gripper", "elbow", "wrist")),
            ("elbow", "wrist"),
            "line 1 has the column 'gripper', which is none of the joints",
        ),
        (
            table(("demonstration", "time", "pos/wrist", "pos/elbow", "pos/shoulder")),
            JOINTS,
            "must call columns as the joints .* got 'pos/wrist'",
        ),
        ("," + table().replace("\n", "\n0,")[:-2], None, "got none for column 1: an index"),
        (table().replace("\n", ",\n"), None, "got none for column 6"),
        (table(("demonstration", "time", "index", "y", "z")), None, "column 'index', which is no"),
        (table(("demonstration", "Unnamed: 0", "y", "z")), None, "column 'Unnamed: 0'"),
        (table(("demonstration", "secs", "y", "z")), None, "column 'secs'"),
        (table(("demonstration", "time", "x", "x", "z")), None, "each column once, got x"),
        (table(("demonstration", "time", "x", "X", "z")), None, "each column once, got X, x"),
        (table().replace("x", "Höhe").encode("latin-1"), None, "line 1 .* UTF-8, got .* 0xf6"),
        (table(stamp=lambda t: min(t, 0.4)), None, "line 5, column 'time': times .* must rise"),
        (table(stamp=lambda t: -t), None, "line 3, column 'time'"),
        (table().replace("0.2,0.2", "0.2,"), None, "line 3, column 'x' must hold numbers, got ''"),
        (table().replace("0.2,0.2", "0.2,nan"), None, "line 3, column 'x' .* finite .*, got nan"),
        (table().replace("0.2,0.2", "0.2,1_0"), None, "line 3, column 'x'"),
        (table().replace("0.2,0.2", "0.2,1e999"), None, "line 3, column 'x' must hold finite"),
        (table().replace("0.2,0.2", '0.2,"0".2'), None, "line 3 is no line of a table"),
        (table()[: table().index("d1")], None, "logs.csv: demonstrations must be at least 2"),
    ],
)
def test_what_cannot_be_meant_is_refused_by_place(tmp_path, content, joints, message):
    with pytest.raises(ValueError, match=message) as caught:
        read(tmp_path, content, joints)
    assert str(tmp_path / "logs.csv") in str(caught.value)


def test_missing_entries_are_read_where_they_may_be(tmp_path):
    found = read(tmp_path, table().replace("0.2,0.2", "0.2,"), nan_is_missing=True)
    assert np.isnan(found[0]).sum() > 0
