"""Sessions as arrays, and what they become in xarray and pandas."""

import builtins

import numpy as np
import pytest

from tactus_eit import QUALITY_FLAGS, Event, Forward, Mesh, OneStep, Session, open_session


@pytest.fixture(scope="module")
def path(expected):
    return expected.folder / "tank.tactus"


@pytest.fixture
def session(path):
    return open_session(path)


def test_frames_of_both_parts(session, expected):
    frames = expected.array("frames", 2, 208)
    last = frames[1].copy()
    last[[0, 1, 5]] = np.nan
    np.testing.assert_array_equal(session.voltages, [frames[0], frames[0], last])
    assert session.status.dtype == np.uint8
    assert session.status[2, :7].tolist() == [1, 3, 0, 0, 0, 3, 0] and not session.status[:2].any()
    assert session.sequence.tolist() == [1, 2, 3] and len(session) == 3
    assert session.damaged == []


def test_times_and_conditions(session):
    start = np.datetime64("2023-11-14T22:13:20.000000", "us")
    assert session.times.dtype == np.dtype("datetime64[us]")
    np.testing.assert_array_equal(session.times - start, np.array([0, 1_500_000, 3_000_000], "timedelta64[us]"))
    assert session.monotonic.tolist() == [0.0, 1.5, 3.0] and session.duration.tolist() == [0.9] * 3
    assert session.current.tolist() == [1e-3] * 3


def test_quality_has_a_bit_for_each_word(session):
    assert QUALITY_FLAGS[0] == "incomplete" and len(QUALITY_FLAGS) == 5
    assert session.quality[2] & 1 and not session.quality[0] & 1
    assert session.quality.dtype == np.uint8


def test_events_baseline_and_attributes(session, expected):
    first = session.events[0]
    assert isinstance(first, Event) and (first.kind, first.text) == ("started", "for the tests")
    assert first.time == np.datetime64("2023-11-14T22:13:20", "us")
    np.testing.assert_array_equal(session.baseline, expected.array("unloaded", 208))
    np.testing.assert_allclose(session.baseline_deviation, np.std(expected.array("baseline", 3, 208), axis=0, ddof=1), rtol=1e-6)
    about = session.attributes
    assert about["id"] == "tank" and about["simulated"] is True and about["note"] == "three frames"
    assert about["closed"] == "asked to stop" and about["protocol_hash"] == session.protocol.hash
    assert repr(session) == "<Session tank, measurement, 3 frames of 208 readings>"


def test_part_of_a_session(path):
    assert open_session(path, first=2, last=2).sequence.tolist() == [2]
    assert open_session(path, first=3).voltages.shape == (1, 208)
    assert open_session(path, first=4).voltages.shape == (0, 208)
    assert Session(str(path), last=1).sequence.tolist() == [1]


def test_maps_of_a_session(session, expected):
    mesh = Mesh.from_case(expected.folder / "case")
    model = OneStep(Forward(mesh, session.protocol), missing="mask").fit(session.baseline)
    assert model.predict(session.voltages).shape == (3, len(mesh.region))
    assert model.masked_.tolist() == [0, 0, 3]


def test_reading_leaves_no_files_behind(path, session):
    before = {file.name: file.stat().st_mtime_ns for file in path.parent.iterdir()}
    assert session.voltages.shape == (3, 208)
    assert {file.name: file.stat().st_mtime_ns for file in path.parent.iterdir()} == before


def test_a_damaged_frame_is_left_out_and_named(path, tmp_path):
    import sqlite3

    copy = tmp_path / path.name
    for part in path.parent.glob("tank*.tactus"):
        (tmp_path / part.name).write_bytes(part.read_bytes())
    with sqlite3.connect(copy) as connection:
        (table,) = connection.execute("SELECT name FROM sqlite_master WHERE name = 'frame'").fetchone()
        column = next(name for _, name, kind, *_ in connection.execute(f"PRAGMA table_info({table})") if kind == "BLOB")
        connection.execute(f"UPDATE {table} SET {column} = x'00'")
    damaged = open_session(copy)
    with pytest.warns(RuntimeWarning, match="a frame is left out.*frame 1"):
        assert damaged.sequence.tolist() == [2, 3]
    assert len(damaged.damaged) == 1


def test_a_damaged_frame_after_the_last_is_not_of_the_part(path, tmp_path):
    import sqlite3

    for part in path.parent.glob("tank*.tactus"):
        copy = tmp_path / part.name
        copy.write_bytes(part.read_bytes())
        with sqlite3.connect(copy) as connection:
            connection.execute("UPDATE frame SET checksum = checksum + 1 WHERE sequence >= 2")
    part = open_session(tmp_path / path.name, last=1)
    assert part.sequence.tolist() == [1] and part.damaged == []
    part = open_session(tmp_path / path.name, last=2)
    with pytest.warns(RuntimeWarning, match="a frame is left out.*frame 2"):
        assert len(part.damaged) == 1


def test_xarray(session):
    xarray = pytest.importorskip("xarray")
    data = session.to_xarray()
    assert isinstance(data, xarray.Dataset)
    assert dict(data.sizes) == {"time": 3, "reading": 208, "pole": 2}
    assert data.voltage.attrs["units"] == "V"
    np.testing.assert_array_equal(data.voltage.values, session.voltages)
    np.testing.assert_array_equal(data.time.values, session.times)
    assert data.status.attrs["flag_meanings"].split()[1] == "overload"
    assert data.attrs["id"] == "tank"
    one = data.voltage.sel(time="2023-11-14T22:13:21.5")
    np.testing.assert_array_equal(np.ravel(one), session.voltages[1])


def test_pandas(session):
    pandas = pytest.importorskip("pandas")
    data = session.to_pandas()
    assert data.shape == (3, 210) and data.columns[:3].tolist() == ["sequence", "quality", "v000"]
    assert data.index[1] == pandas.Timestamp("2023-11-14T22:13:21.5", tz="UTC")
    np.testing.assert_array_equal(data["v005"], session.voltages[:, 5])


@pytest.mark.parametrize(("name", "call"), [("xarray", Session.to_xarray), ("pandas", Session.to_pandas)])
def test_what_is_not_installed_is_named(session, monkeypatch, name, call):
    real = builtins.__import__

    def missing(module, *others, **more):
        if module == name:
            raise ImportError(f"No module named {name!r}")
        return real(module, *others, **more)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(ImportError, match=f"pip install {name}"):
        call(session)
