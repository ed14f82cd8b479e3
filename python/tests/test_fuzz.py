"""Arbitrary shapes, types and values: a result or an exception of Python, never a panic, and arguments stay as they are."""

import itertools
import reprlib

import numpy as np
import pytest

import tactus_eit
import tactus_eit.eidors
import tactus_eit.pyeit
from tactus_eit import Forward, Mesh, OneStep, Protocol, TotalVariation

# pytest makes errors of warnings
ALLOWED = (TypeError, ValueError, OverflowError, OSError, RuntimeError, UserWarning)
DTYPES = [
    "?", "i1", "u1", "i4", ">i4", "u8", "f2", "f4", ">f8", "f8", "g", "c8", "c16", "O", "U3", "S2", "M8[s]", "m8[us]", "V4",
]
SHAPES = [(), (0,), (1,), (2,), (3, 2), (2, 3), (0, 2), (4, 0), (208,), (3, 208), (208, 3), (912,), (2, 912), (1, 1, 1), (16,)]
SCALARS = [
    None, True, -1, 0, 1, 3, 16, 2**31, 2**63, 2**64, -(2**70), 0.0, -0.5, 0.25, 1e-300, 1e300, float("nan"), float("inf"),
    1j, "", "noser", "\0", b"x", [], [[]], [[1], [2, 3]], {}, {1: 2}, object(), range(3), iter([1, 2]), np.ma.masked, slice(1),
    np.array(7), np.float32(2), np.datetime64("2020"), Ellipsis, int, lambda: 1,
]  # fmt: skip


def arrays(seed):
    """An array for each pair of shape and type, with extreme values among its entries."""
    random = np.random.default_rng(seed)
    for shape, dtype in itertools.product(SHAPES, DTYPES):
        values = random.choice([0.0, 1.0, 2.0, 3.0, 15.0, 907.0, -1.0, 1e-3, 1e9, np.nan, np.inf], size=shape)
        with np.errstate(all="ignore"):
            try:
                if dtype[-1] in "?iu148" and dtype.lstrip(">")[0] in "?iu":
                    values = np.nan_to_num(values, posinf=1.0)
                array = np.asarray(values).astype(dtype)
            except (TypeError, ValueError):
                array = np.zeros(shape, dtype)
        yield array
        if array.ndim == 2:
            yield np.asfortranarray(array)
            yield array[::-1, ::2]
            read_only = array.copy()
            read_only.flags.writeable = False
            yield read_only


def anything():
    yield from SCALARS
    yield from arrays(5)


def survives(call, *arguments):
    """Calls; the only errors are those of Python, each with a text."""
    kept = [argument.copy() if type(argument) is np.ndarray else None for argument in arguments]
    try:
        call(*arguments)
    except ALLOWED as error:
        assert str(error), error
        assert "a defect of tactus_eit" not in str(error), error
    except BaseException as error:  # a panic of Rust is no Exception
        pytest.fail(f"{type(error).__module__}.{type(error).__name__}: {error}, for {reprlib.repr(arguments)}")
    for argument, copy in zip(arguments, kept):
        if copy is not None:
            assert argument.tobytes() == copy.tobytes()


NODES = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])
ELECTRODES = [np.array([[3, 0]]), np.array([[1, 2]])]

FUNCTIONS = {
    "nodes": lambda x: Mesh(x, TRIANGLES, ELECTRODES),
    "triangles": lambda x: Mesh(NODES, x, ELECTRODES),
    "electrodes": lambda x: Mesh(NODES, TRIANGLES, x),
    "an electrode": lambda x: Mesh(NODES, TRIANGLES, [x, x]),
    "region": lambda x: Mesh(NODES, TRIANGLES, ELECTRODES, region=x),
    "sheet": lambda x: Mesh.sheet(width=x, fineness=0.25),
    "sheet's electrodes": lambda x: Mesh.sheet(electrodes_per_width=x, electrode_size=1e-3, inset=x, fineness=0.25),
    "disc": lambda x: Mesh.disc(radius=x, fineness=0.25),
    "disc's electrodes": lambda x: Mesh.disc(electrodes=x, arc_deg=1.0, first_deg=x, fineness=0.25),
    "seeding": lambda x: Mesh.disc(seeding=x, fineness=0.25),
    "sheffield": lambda x: Protocol.sheffield(x),
    "skip": lambda x: Protocol.sheffield(16, skip=x),
    "inject": lambda x: Protocol.from_pairs(x, x),
    "measure": lambda x: Protocol.from_pairs([[0, 1], [1, 2], [2, 3]], x, 4),
    "number of electrodes": lambda x: Protocol.from_pairs([[0, 1]], [[2, 3]], x),
    "order": lambda x: Protocol.sheffield(16).renumbered(x),
    "case folder": lambda x: Mesh.from_case(x),
    "EIDORS": lambda x: tactus_eit.eidors.forward(x),
    "a field of EIDORS": lambda x: tactus_eit.eidors.forward(
        {"nodes": x, "elems": x, "electrode": [{"nodes": x, "z_contact": x}], "stimulation": [{"stim_pattern": x, "meas_pattern": x}]}
    ),
    "an electrode of EIDORS": lambda x: tactus_eit.eidors.mesh({"nodes": NODES, "elems": TRIANGLES + 1.0, "electrode": x}),
    "nodes of an electrode of EIDORS": lambda x: tactus_eit.eidors.mesh(
        {"nodes": NODES, "elems": TRIANGLES + 1.0, "electrode": [{"nodes": x}, {"nodes": [2, 3]}]}
    ),
    "stimulation of EIDORS": lambda x: tactus_eit.eidors.protocol({"stimulation": [{"stim_pattern": x, "meas_pattern": x}]}),
    "protocol of a case": lambda x: Protocol.from_case(x, x),
    "session": lambda x: tactus_eit.open_session(x),
    "first frame": lambda x: tactus_eit.open_session("none", first=x, last=x),
    "image": lambda x: tactus_eit.merit(x, [0.0, 0.0]),
    "target": lambda x: tactus_eit.merit([[1.0, 2.0], [3.0, 4.0]], x),
    "likeness": lambda x: tactus_eit.likeness(x, x, x),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions(name):
    if name == "seeding":
        # each seed is a new mesh: numbers are enough
        for value in SCALARS:
            survives(FUNCTIONS[name], value)
        return
    for value in anything():
        survives(FUNCTIONS[name], value)


def test_forward_models(mesh, protocol, forward):
    for value in anything():
        survives(lambda x: Forward(mesh, protocol, x), value)
        survives(lambda x: Forward(x, x, x), value)
        survives(forward.solve, value)
        survives(forward.transfer, value)
        survives(lambda x: tactus_eit.check(x, forward), value)
        survives(lambda x: tactus_eit.check(np.ones(208), forward, sigma0=x), value)
    for value in SCALARS:
        survives(forward.jacobian, value)
        survives(lambda x: forward.jacobian(1e-3, region=x, log=x), value)


def test_drift(forward, baseline):
    drift = tactus_eit.Drift(forward).fit(baseline)
    for time, value in enumerate(anything(), 1):
        survives(lambda x, time=time: drift.follow(x, float(time)), value)
        survives(lambda x: drift.follow(baseline, x), value)
    for value in SCALARS:
        survives(lambda x: tactus_eit.Drift(forward, sigma0=x, current=x).fit(baseline), value)
        survives(lambda x: tactus_eit.Drift(forward).fit(baseline, noise=x, time=x), value)
        survives(drift.restore, value)
        survives(lambda x: tactus_eit.Drift(x), value)
        survives(lambda x: tactus_eit.Network(forward, x).fit(baseline), value)
        survives(lambda x: tactus_eit.Shapes(forward, losses_only=x).fit(x, noise=x), value)


@pytest.mark.parametrize("method", [OneStep, TotalVariation])
def test_estimators(forward, baseline, method):
    model = method(forward, lam=0.1, missing="mask").fit(baseline)
    for value in anything():
        survives(model.predict, value)
        survives(model.judge, value)
        survives(lambda x: model.predict(baseline, baselines=x), value)
        survives(method(forward, lam=0.1).fit, value)
    for value in SCALARS:
        survives(lambda x: method(forward, lam=0.1).fit(baseline, noise=x), value)
        for name in model.get_params():
            survives(lambda x, name=name: method(forward).set_params(**{name: x}).fit(baseline), value)


def test_readings_of_extreme_size(forward, baseline):
    """Numbers that overflow or vanish in a product."""
    for scale in (1e-320, 1e-200, 1e-30, 1e30, 1e200, 1e307):
        for method in (OneStep, TotalVariation):
            survives(lambda x: method(forward).fit(x).predict(1.01 * x), scale * baseline)
        survives(lambda x: tactus_eit.check(x, forward), scale * baseline)
        survives(forward.solve, np.full(912, scale))
        survives(forward.jacobian, np.linspace(scale, 1.0, 912))
        survives(lambda x: Forward(forward.mesh, forward.protocol, x).transfer(1e-3), np.full(16, scale))
        survives(lambda x: Mesh(x, TRIANGLES, ELECTRODES), scale * NODES)


def test_objects_for_pyeit():
    from types import SimpleNamespace

    turn = 2.0 * np.pi * np.arange(24) / 24
    node = np.vstack([[[0.0, 0.0]], np.c_[np.cos(turn), np.sin(turn)]])
    element = np.array([[0, 1 + k, 1 + (k + 1) % 24] for k in range(24)])
    good = dict(node=node, element=element, el_pos=np.arange(1, 25, 3), perm=1.0)
    pairs = dict(
        ex_mat=np.array([[k, (k + 1) % 8] for k in range(8)]),
        meas_mat=np.array([[[(k + m + 1) % 8, (k + m) % 8] for m in range(2, 7)] for k in range(8)]),
    )
    jac = tactus_eit.pyeit.JAC(SimpleNamespace(**good), SimpleNamespace(**pairs)).setup()
    for value in anything():
        for name in good:
            survives(
                lambda x, name=name: tactus_eit.pyeit.JAC(SimpleNamespace(**{**good, name: x}), SimpleNamespace(**pairs)).setup(),
                value,
            )
        for name in pairs:
            survives(
                lambda x, name=name: tactus_eit.pyeit.JAC(SimpleNamespace(**good), SimpleNamespace(**{**pairs, name: x})), value
            )
        survives(lambda x: jac.solve(x, jac.v0), value)
        survives(lambda x: jac.solve(jac.v0, x, normalize=True), value)
        survives(lambda x: jac.fwd.solve_eit(x), value)
    for value in SCALARS:
        survives(lambda x: tactus_eit.pyeit.JAC(SimpleNamespace(**good), SimpleNamespace(**pairs)).setup(p=x, lamb=x), value)
