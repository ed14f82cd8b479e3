"""Long work shows how far it is, and ends on Ctrl-C."""

import contextlib
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from tactus_eit import Drift, Forward, Mesh, OneStep, Protocol, TotalVariation

MANY = 60_000


def interrupted(call):
    """Runs a call that gets the signal of Ctrl-C after 0.3 s; returns the time after the signal, s."""
    main = threading.main_thread().ident
    sent = []

    def interrupt():
        sent.append(time.monotonic())
        signal.pthread_kill(main, signal.SIGINT)

    timer = threading.Timer(0.3, interrupt)
    # a shell starts background jobs with this signal ignored
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            timer.start()
            call()
        timer.join()
    finally:
        signal.signal(signal.SIGINT, before)
    return time.monotonic() - sent[0]


def test_ctrl_c_ends_long_work(forward, baseline, frame):
    frames = np.tile(frame, (MANY, 1))
    variation = TotalVariation(forward).fit(baseline)
    drift = Drift(forward).fit(baseline)
    sheet = Forward(Mesh.sheet(), Protocol.sheffield(26))
    # 2 ms a row
    sigma = np.full((9000, len(sheet.mesh.triangles)), 1e-3)
    # each would take 18 s or more
    for call in (
        lambda: variation.predict(frames),
        lambda: variation.judge(frames),
        lambda: drift.follow(frames, np.arange(1.0, MANY + 1)),
        lambda: sheet.solve(sigma),
    ):
        assert interrupted(call) < 5.0
    # and all of them can be used afterwards
    assert variation.predict(frame).shape == forward.mesh.region.shape
    assert drift.follow(frame, 1e9).known[0]["judgement"] in ("empty", "loaded", "unknown")


def test_ctrl_c_ends_one_long_fit():
    tank = Forward(Mesh.disc(electrodes=32, fineness=2.0), Protocol.sheffield(32))
    baseline = 1e-3 * tank.solve(1e-3)
    model = OneStep(tank, prior="gaussian")
    interrupted(lambda: model.fit(baseline, noise=2e-6))
    # the call has ended before its work, which nobody waits for
    names = set()
    for task in Path("/proc/self/task").iterdir():
        # a thread may end in between
        with contextlib.suppress(OSError):
            names.add(Path(task, "comm").read_text().strip())
    assert "tactus_eit" in names
    assert not hasattr(model, "noise_")


def test_progress_is_called_after_each_frame(forward, baseline, frame):
    model, drift = OneStep(forward).fit(baseline), Drift(forward).fit(baseline)
    for call in (model.predict, model.judge, lambda frames, **more: drift.follow(frames, [1.0, 2.0, 3.0], **more)):
        calls = []
        call([frame] * 3, progress=lambda done, total, calls=calls: calls.append((done, total)))
        assert calls == [(1, 3), (2, 3), (3, 3)]


def test_what_progress_raises_ends_the_work(forward, baseline, frame):
    class Enough(Exception):
        pass

    def stop(done, total):
        if done == 2:
            raise Enough

    with pytest.raises(Enough):
        OneStep(forward).fit(baseline).predict([frame] * 3, progress=stop)
    with pytest.raises(TypeError, match="'progress'.*float"):
        OneStep(forward).fit(baseline).predict(frame, progress=1.0)
