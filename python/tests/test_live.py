"""The stream of a real tactusd on the simulated rig."""

import json
import os
import signal
import socket
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest

import tactus_eit
from tactus_eit import Forward, LiveFrame, LiveMap, Mesh, OneStep, connect, open_session

PROJECT = Path(__file__).parents[2]
#: Ends a test that hangs, s.
LIMIT = 120
READINGS = 598


class Daemon:
    """A tactusd with a folder of its own, in instant time; frames are taken one by one, when a test asks for them."""

    def __init__(self, programs, folder):
        self.programs, self.folder = programs, folder
        rigs = PROJECT / "demo" / "rigs"
        config = (rigs / "simulated.toml").read_text().replace("STAGE", str(folder))
        # each map is then that of the frame and the recorded baseline
        config = config.replace("[model]\n", "[model]\ntracking = false\n")
        (folder / "config.toml").write_text(config)
        (folder / "profile.toml").write_text((rigs / "instant.toml").read_text())
        (folder / "scene.toml").write_text((rigs / "two-microvolts.toml").read_text())
        self.address = f"unix:{folder / 'peer'}"
        self.environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith(("TACTUS_", "DBUS_"))},
            "XDG_RUNTIME_DIR": str(folder),
            "XDG_STATE_HOME": str(folder),
            "NOTIFY_SOCKET": str(folder / "notify"),
        }
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify, open(folder / "log", "w") as log:
            notify.bind(str(folder / "notify"))
            notify.settimeout(LIMIT)
            command = [programs / "tactusd", "--config", folder / "config.toml"]
            self.process = subprocess.Popen(command, env=self.environment, stderr=log, stdout=subprocess.DEVNULL)
            # without a daemon nobody would write to the socket
            threading.Thread(target=self._report_end, daemon=True).start()
            while "READY=1" not in (text := notify.recv(4096).decode()).splitlines():
                assert text != "ENDED", (folder / "log").read_text()

    def _report_end(self):
        self.process.wait()
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify:
            try:
                notify.sendto(b"ENDED", str(self.folder / "notify"))
            except OSError:
                pass  # it was ready before

    def ask(self, *words):
        command = [self.programs / "tactus", "--bus", self.address, "--state", self.folder / "state", "--json", *words]
        done = subprocess.run(command, env=self.environment, capture_output=True, text=True, timeout=LIMIT)
        assert done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
        return [json.loads(line) for line in done.stdout.splitlines()]

    def connect(self, **options):
        return connect(self.address, **{"timeout": LIMIT, **options})

    def stop(self):
        self.process.terminate()
        self.process.wait(LIMIT)


@pytest.fixture(scope="module")
def programs():
    """The folder with tactusd and tactus: TACTUS_PROGRAMS, or what the project has built."""
    named = os.environ.get("TACTUS_PROGRAMS")
    folder = Path(named) if named else PROJECT / "target" / "debug"
    lacking = [name for name in ("tactusd", "tactus") if not (folder / name).is_file()]
    if lacking and named:
        raise FileNotFoundError(f"TACTUS_PROGRAMS={named} has no {' and no '.join(lacking)}")
    if lacking:
        pytest.skip(f"{folder} has no {' and no '.join(lacking)}: cargo build -p tactus-daemon -p tactus-cli makes them")
    return folder


@pytest.fixture(scope="module")
def daemon(programs, tmp_path_factory):
    started = Daemon(programs, tmp_path_factory.mktemp("daemon"))
    started.ask("baseline", "record", "--frames", "3")
    yield started
    started.stop()


@pytest.fixture
def session(daemon):
    """The id of a session that takes a frame on each step."""
    (started,) = daemon.ask("start", "--step")
    yield started["session"]
    if daemon.process.poll() is None and daemon.ask("status")[0]["session"]:
        daemon.ask("stop")


def test_frames_are_those_of_the_record(daemon, session):
    with daemon.connect() as live:
        assert live.session == session and live.attributes["simulated"] is True and live.attributes["kind"] == "measurement"
        daemon.ask("step", "3")
        frames = [next(live) for _ in range(3)]
        daemon.ask("stop")
        with pytest.raises(StopIteration):
            next(live)
        assert live.ended and live.lost == 0
    assert all(isinstance(frame, LiveFrame) and frame.simulated and frame.lost == 0 for frame in frames)
    record = open_session(live.attributes["path"])
    assert [frame.sequence for frame in frames] == record.sequence.tolist() == [1, 2, 3]
    np.testing.assert_array_equal([frame.voltages for frame in frames], record.voltages)
    np.testing.assert_array_equal([frame.status for frame in frames], record.status)
    times = np.array([frame.time for frame in frames])
    np.testing.assert_array_equal(times.astype("datetime64[us]"), record.times)
    np.testing.assert_array_equal(live.baseline, record.baseline)
    assert live.baseline_deviation.shape == (READINGS,)


def test_maps_are_like_those_of_the_package(daemon, session):
    daemon.ask("step")
    live = daemon.connect(frames=False, maps=True)
    maps = []
    for _ in range(2):
        daemon.ask("step")
        # that of the step before the connection may come late
        maps.append(next(one for one in live if one.sequence > 1))
    record = open_session(live.attributes["path"])
    mesh = Mesh.sheet()
    made = OneStep(Forward(mesh, record.protocol)).fit(live.baseline, noise=2e-6).predict(record.voltages[1:])
    for own, one in zip(made, maps, strict=True):
        assert isinstance(one, LiveMap) and one.mesh_hash == mesh.hash and one.method.startswith("one-step")
        # the daemon knows the sheet, and the package fits it to the baseline
        assert np.abs(one.values - own).max() < 0.01 * np.abs(own).max()
        assert one.quality.verdict in ("sound", "doubtful", "unreliable") and one.pressure is None
    assert [one.sequence for one in maps] == [2, 3]
    assert live.triangles.shape == (len(mesh.region), 3)
    centroids = live.nodes[live.triangles].mean(axis=1)
    np.testing.assert_allclose(centroids, mesh.centroids[mesh.region], atol=1e-12)
    np.testing.assert_allclose(live.electrode_centres, mesh.electrode_centres, atol=1e-12)
    live.close()
    with pytest.raises(RuntimeError, match="closed"):
        next(live)


def test_deviation_is_a_record_beside_the_maps():
    class Records:
        attributes = {"session": "m1", "address": "unix:peer"}
        given = [
            {"kind": "quality", "sequence": 2, "gap": 1, "json": '{"verdict": "sound", "reasons": []}'},
            {
                "kind": "deviation",
                "sequence": 1,
                "wall_ns": 5,
                "gap": 2,
                "simulated": True,
                "deviations": np.array([0.05, np.nan]),
                "mesh_hash": "m",
            },
            {
                "kind": "map",
                "sequence": 2,
                "wall_ns": 6,
                "gap": 0,
                "simulated": True,
                "values": np.zeros(2),
                "method": "one-step",
                "mesh_hash": "m",
            },
        ]

        def next(self, timeout):
            return self.given.pop(0)

    live = tactus_eit.Live(Records(), None)
    deviation, map_ = next(live), next(live)
    assert isinstance(deviation, tactus_eit.LiveDeviation) and (deviation.sequence, deviation.lost) == (1, 2)
    np.testing.assert_array_equal(deviation.values, [0.05, np.nan])
    assert isinstance(map_, LiveMap) and map_.quality.verdict == "sound" and (map_.lost, live.lost) == (1, 3)
    with pytest.raises(ValueError, match="expected one of them to be True"):
        connect(frames=False, deviations=False)


def test_slow_reader_counts_what_it_lost(daemon, session):
    live = daemon.connect(ring=1)
    # some 35 fit into the socket
    daemon.ask("step", "50")
    first = next(live)
    daemon.ask("step")
    daemon.ask("stop")
    frames = [first, *live]
    assert live.lost > 0 and len(frames) + live.lost == 51
    jumps = [next.sequence - one.sequence - 1 for one, next in zip(frames, frames[1:], strict=False)]
    assert [frame.lost for frame in frames[1:]] == jumps


def test_both_kinds_come_in_order(daemon, session):
    live = daemon.connect(maps=True)
    daemon.ask("step")
    # a frame gets no map if it comes before the map of the previous one is made
    records = [next(live), next(live)]
    daemon.ask("step")
    daemon.ask("stop")
    kinds = [(type(record).__name__, record.sequence) for record in [*records, *live]]
    assert sorted(kinds) == [("LiveFrame", 1), ("LiveFrame", 2), ("LiveMap", 1), ("LiveMap", 2)]
    for number in (1, 2):
        assert kinds.index(("LiveFrame", number)) < kinds.index(("LiveMap", number))


def test_stream_goes_on_after_a_timeout(daemon, session):
    # the timeout counts for the connection too
    live = daemon.connect(timeout=5.0)
    with pytest.raises(TimeoutError, match=rf"{session}.* 5(\.0)? s"):
        next(live)
    daemon.ask("step")
    assert next(live).sequence == 1


def test_ctrl_c_ends_the_wait_for_a_frame(daemon, session):
    live = daemon.connect()
    main = threading.main_thread().ident
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.3, lambda: signal.pthread_kill(main, signal.SIGINT))
    try:
        with pytest.raises(KeyboardInterrupt):
            timer.start()
            next(live)
    finally:
        timer.join()
        signal.signal(signal.SIGINT, before)
    daemon.ask("step")
    assert next(live).sequence == 1


def test_connect_waits_for_the_next_session(daemon):
    found = []
    waiting = threading.Thread(target=lambda: found.append(daemon.connect()))
    waiting.start()
    (started,) = daemon.ask("start", "--step")
    waiting.join(LIMIT)
    assert [live.session for live in found] == [started["session"]]
    daemon.ask("stop")


def test_what_cannot_be_followed_is_named(daemon, tmp_path):
    with pytest.raises(TimeoutError, match="tactus start"):
        daemon.connect(timeout=0.1)
    with pytest.raises(LookupError, match="m20200101_1"):
        daemon.connect(session="m20200101_1")
    with pytest.raises(LookupError, match="'session'.*not an id"):
        daemon.connect(session="no/id")
    with pytest.raises(ConnectionError, match=str(tmp_path / "peer")):
        connect(f"unix:{tmp_path / 'peer'}")


def test_daemon_that_is_gone_is_an_error(programs, tmp_path):
    daemon = Daemon(programs, tmp_path)
    daemon.ask("baseline", "record", "--frames", "2")
    daemon.ask("start", "--step")
    live = daemon.connect()
    daemon.ask("step")
    assert next(live).sequence == 1
    daemon.process.kill()
    for _ in range(2):
        with pytest.raises(ConnectionError, match="stopped.*connect"):
            next(live)


@pytest.mark.parametrize(
    ("options", "kind", "text"),
    [
        ({"address": "tcp:host"}, ValueError, "'address'.*unix:PATH"),
        ({"address": 7}, TypeError, "'address'.*int"),
        ({"session": 7}, TypeError, "'session'.*int"),
        ({"frames": 1}, TypeError, "'frames'.*int"),
        ({"frames": False}, ValueError, "'maps'.*'frames'"),
        ({"ring": 0}, ValueError, "'ring'.*0.*4096"),
        ({"ring": 1.0}, TypeError, "'ring'.*float"),
        ({"timeout": "1 s"}, TypeError, "'timeout'.*str"),
        ({"timeout": -1}, ValueError, "'timeout'.*-1"),
    ],
)
def test_arguments_that_do_not_fit(options, kind, text):
    with pytest.raises(kind, match=text):
        tactus_eit.connect(**options)
