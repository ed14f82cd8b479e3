"""A wrong argument is a TypeError or ValueError that has the argument's name, what is expected, and how to mend it."""

import numpy as np
import pytest

import tactus_eit
from tactus_eit import Forward, Mesh, OneStep, Protocol, TotalVariation

NODES = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
TRIANGLES = [[0, 1, 2], [0, 2, 3]]
ELECTRODES = [[[3, 0]], [[1, 2]]]
NAN = float("nan")

MESHES = {
    "nodes in one row": (dict(nodes=[0.0, 1.0]), ValueError, ["'nodes'", "(2,)", "shape (nodes, 2)"]),
    "nodes with three coordinates": (dict(nodes=np.zeros((4, 3))), ValueError, ["'nodes'", "(4, 3)"]),
    "a node that is NaN": (dict(nodes=[[0, 0], [1, 0], [1, NAN], [0, 1]]), ValueError, ["'nodes'", "[2, 1]", "nan"]),
    "complex nodes": (dict(nodes=np.array(NODES, dtype=complex)), TypeError, ["'nodes'", "complex", "real part"]),
    "nodes of text": (dict(nodes=[["a", "b"]]), TypeError, ["'nodes'", "not numeric", "dtype=float"]),
    "nodes that are None": (dict(nodes=None), TypeError, ["'nodes'", "not numeric"]),
    "ragged nodes": (dict(nodes=[[0.0, 1.0], [2.0]]), TypeError, ["'nodes'", "no array"]),
    "triangles of floats": (dict(triangles=np.array(TRIANGLES, dtype=float)), TypeError, ["'triangles'", "astype(int)"]),
    "triangles with four corners": (dict(triangles=[[0, 1, 2, 3]]), ValueError, ["'triangles'", "(1, 4)"]),
    "a negative node": (dict(triangles=[[0, 1, -1]]), ValueError, ["'triangles'", "[0, 2]", "-1", "from 0"]),
    "nodes counted from 1": (dict(triangles=[[1, 2, 3], [1, 3, 4]]), ValueError, ["node 4", "subtract 1"]),
    "a clockwise triangle": (dict(triangles=[[0, 2, 1], [0, 2, 3]]), ValueError, ["element 0", "[:, ::-1]"]),
    "a node of no triangle": (dict(triangles=[[0, 1, 2]]), ValueError, ["node 3", "numpy.unique"]),
    "no triangles": (dict(triangles=np.empty((0, 3), dtype=int)), ValueError, ["at least one triangle"]),
    "electrodes as a number": (dict(electrodes=3), TypeError, ["'electrodes'", "no list"]),
    "an electrode without an edge": (dict(electrodes=[[], [[1, 2]]]), ValueError, ["electrode 1", "edge", "outline"]),
    "an electrode inside": (dict(electrodes=[[[0, 2]], [[1, 2]]]), ValueError, ["electrode 1", "boundary"]),
    "electrodes that meet": (dict(electrodes=[[[0, 1]], [[1, 2]]]), ValueError, ["1 and 2 meet at node 1"]),
    "an electrode of booleans": (dict(electrodes=[[[True, False]]]), TypeError, ["'electrodes'", "flatnonzero"]),
    "a region that does not exist": (dict(region=[7]), ValueError, ["region"]),
}


def fails(error, words, call):
    with pytest.raises(error) as raised:
        call()
    assert raised.type is error
    for word in words:
        assert word in str(raised.value), (word, str(raised.value))


@pytest.mark.parametrize("name", MESHES)
def test_meshes(name):
    given, error, words = MESHES[name]
    fails(error, words, lambda: Mesh(**{"nodes": NODES, "triangles": TRIANGLES, "electrodes": ELECTRODES, **given}))


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: Mesh.sheet(width=-1.0), ValueError, ["'width'", "above 0"]),
        (lambda: Mesh.sheet(width="wide"), TypeError, ["'width'", "length in m"]),
        (lambda: Mesh.sheet(width=NAN), ValueError, ["'width'", "nan"]),
        (lambda: Mesh.sheet(electrode="disc"), ValueError, ["'electrode'", "void"]),
        (lambda: Mesh.sheet(electrodes_per_width=0), ValueError, ["'electrodes_per_width'", "1 to 256"]),
        (lambda: Mesh.sheet(electrode_size=0.2), ValueError, ["paper-sheet"]),
        (lambda: Mesh.sheet(fineness=100.0), ValueError, ["fineness", "0.25 to 8"]),
        (lambda: Mesh.sheet(seeding=2**32), ValueError, ["'seeding'", "4294967295"]),
        (lambda: Mesh.disc(electrodes=1), ValueError, ["electrodes is 1", "2 to 256"]),
        (lambda: Mesh.disc(electrodes=16.0), TypeError, ["'electrodes'", "integers"]),
        (lambda: Mesh.disc(arc_deg=30.0), ValueError, ["arc_deg is 30"]),
        (lambda: Mesh.disc(radius=[0.1, 0.2]), ValueError, ["'radius'", "(2,)"]),
        (lambda: Mesh.from_case("no-such-folder"), ValueError, ["no-such-folder"]),
        (lambda: Mesh.from_case(3), TypeError, ["folder"]),
        (lambda: Protocol.from_case("no-such-folder"), ValueError, ["no-such-folder"]),
        (lambda: Protocol.sheffield(3), ValueError, ["'electrodes'", "from 4 to 1024"]),
        (lambda: Protocol.sheffield(10**9), ValueError, ["'electrodes'", "1024"]),
        (lambda: Protocol.sheffield(16, skip=15), ValueError, ["'skip'", "15 of 16"]),
        (lambda: Protocol.sheffield(16, skip=-1), ValueError, ["'skip'", "-1"]),
        (lambda: Protocol.from_pairs([[0, 1]], [[2, 3], [3, 4]]), ValueError, ["'measure'", "2 rows", "repeat a pair"]),
        (lambda: Protocol.from_pairs([[0, 0]], [[2, 3]]), ValueError, ["'inject'", "itself"]),
        (lambda: Protocol.from_pairs([[0, 1, 2]], [[2, 3, 4]]), ValueError, ["'inject'", "(1, 3)"]),
        (lambda: Protocol.from_pairs([], []), ValueError, ["'inject'", "(0,)"]),
        (lambda: Protocol.from_pairs(np.array([[0, 2**63]], dtype=np.uint64), [[1, 2]]), ValueError, ["'electrodes'", "1024"]),
        (lambda: Protocol.from_pairs([[0, 5]], [[1, 2]], electrodes=4), ValueError, ["reading 0", "electrode 6"]),
        (lambda: Protocol.sheffield(4).renumbered([0, 1, 2]), ValueError, ["'order'", "(3,)"]),
        (lambda: Protocol.sheffield(4).renumbered([0, 1, 2, 2]), ValueError, ["'order'", "electrode 2", "twice"]),
        (lambda: Protocol.sheffield(4).renumbered([0, 1, 2, 9]), ValueError, ["'order'", "electrode 9"]),
        (lambda: tactus_eit.merit([[0.0, 0.0], [0.0, 0.0]], [0, 0]), ValueError, ["'image'", "negate"]),
        (lambda: tactus_eit.merit([[1.0]], [0, 0]), ValueError, ["'image'", "2 x 2"]),
        (lambda: tactus_eit.merit(np.empty((2, 0)), [0, 0]), ValueError, ["'image'"]),
        (lambda: tactus_eit.merit([[1.0, 2.0], [0.0, 1.0]], [0, 0, 0]), ValueError, ["'target'", "(3,)"]),
        (lambda: tactus_eit.likeness([1.0], [1.0, 2.0], [1.0]), ValueError, ["'truth'", "(2,)"]),
        (lambda: tactus_eit.likeness([1.0], [1.0], [0.0]), ValueError, ["'areas'", "above 0"]),
        (lambda: tactus_eit.open_session("no-such-session.tactus"), FileNotFoundError, ["no-such-session"]),
        (lambda: tactus_eit.open_session(__file__), OSError, ["test_arguments"]),
        (lambda: tactus_eit.open_session("x", first=0), ValueError, ["'first'", "from 1"]),
        (lambda: tactus_eit.open_session("x", first=3, last=2), ValueError, ["'last'", "from 3"]),
        (lambda: tactus_eit.open_session("x", last=2.0), TypeError, ["'last'", "float"]),
    ],
)
def test_other_functions(call, error, words):
    fails(error, words, call)


@pytest.mark.parametrize(
    ("sigma", "error", "words"),
    [
        (np.ones(5), ValueError, ["'sigma'", "(5,)", "(912,)", "(rows, 912)"]),
        (np.ones((912, 2)), ValueError, ["'sigma'", "(912, 2)"]),
        (np.ones((2, 3, 912)), ValueError, ["'sigma'", "(2, 3, 912)"]),
        (-1.0, ValueError, ["'sigma'", "-1", "0 or more"]),
        (NAN, ValueError, ["'sigma'", "nan"]),
        (np.inf, ValueError, ["'sigma'", "inf"]),
        (0.0, ValueError, ["no element conducts"]),
        (1j, TypeError, ["'sigma'", "complex"]),
        (True, TypeError, ["'sigma'", "booleans"]),
        ("1", TypeError, ["'sigma'", "not numeric"]),
        (np.ma.masked_array(np.ones(912)), TypeError, ["'sigma'", "masked", "filled"]),
        (np.array(["2020"], dtype="datetime64[s]"), TypeError, ["'sigma'", "datetime64"]),
    ],
)
def test_conductances(forward, sigma, error, words):
    fails(error, words, lambda: forward.solve(sigma))


def test_the_jacobian_takes_one_conductance(forward):
    fails(ValueError, ["'sigma'", "(2, 912)", "(912,)"], lambda: forward.jacobian(np.ones((2, 912))))
    fails(ValueError, ["'sigma'"], lambda: forward.transfer(np.ones((2, 912))))


def test_forward_models(mesh, protocol):
    bare = Mesh(NODES, TRIANGLES, ELECTRODES)
    fails(ValueError, ["'protocol'", "26", "16"], lambda: Forward(mesh, Protocol.sheffield(26)))
    two = Protocol.from_pairs([[0, 1]], [[0, 1]])
    fails(ValueError, ["'contact'", "missing", "electrode_lengths"], lambda: Forward(bare, two))
    fails(ValueError, ["'contact'", "(3,)", "(16,)"], lambda: Forward(mesh, protocol, [1.0, 2.0, 3.0]))
    fails(ValueError, ["'contact'", "-1"], lambda: Forward(mesh, protocol, -1.0))
    fails(TypeError, ["mesh"], lambda: Forward(3, protocol))
    fails(TypeError, ["protocol"], lambda: Forward(mesh, None))


@pytest.mark.parametrize("method", [OneStep, TotalVariation])
@pytest.mark.parametrize(
    ("params", "error", "words"),
    [
        (dict(lam="best"), ValueError, ["'lam'", "evidence", "l-curve"]),
        (dict(lam=0.0), ValueError, ["'lam'", "above 0"]),
        (dict(lam=True), TypeError, ["'lam'", "bool"]),
        (dict(lam=None), TypeError, ["'lam'", "NoneType"]),
        (dict(lam=NAN), ValueError, ["'lam'", "nan"]),
        (dict(unknowns="all"), ValueError, ["'unknowns'", "sheet"]),
        (dict(missing=1), TypeError, ["'missing'", "mask"]),
        (dict(losses_only="yes"), TypeError, ["'losses_only'", "True or False"]),
        (dict(check_order=1), TypeError, ["'check_order'"]),
        (dict(current=0.0), ValueError, ["'current'", "above 0"]),
        (dict(current="1 mA"), TypeError, ["'current'", "in A"]),
        (dict(sigma0=-1.0), ValueError, ["sigma", "-1"]),
        (dict(sigma0=np.ones(3)), ValueError, ["sigma", "(3,)"]),
        (dict(forward="model"), TypeError, ["'forward'", "Forward(mesh"]),
    ],
)
def test_parameters(forward, baseline, method, params, error, words):
    model = method(**{"forward": forward, **params})
    fails(error, words, lambda: model.fit(baseline))
    fails(RuntimeError, ["fit(baseline"], lambda: model.predict(baseline))


@pytest.mark.parametrize(
    ("params", "error", "words"),
    [
        (dict(prior="l1"), ValueError, ["'prior'", "tikhonov"]),
        (dict(prior=None), TypeError, ["'prior'"]),
        (dict(exponent=-1.0), ValueError, ["'exponent'"]),
        (dict(prior="gaussian", length=0), ValueError, ["'length'"]),
        (dict(prior="gaussian", exponent=0.5), ValueError, ["'exponent'", "'noser'"]),
        (dict(length=0.02), ValueError, ["'length'", "'gaussian'"]),
        (dict(noise_figure=1.0, lam=0.5), ValueError, ["'noise_figure'", "'lam'"]),
        (dict(noise_figure=1e-9), ValueError, ["noise figure"]),
        (dict(lam=1e-300), ValueError, ["lambda"]),
    ],
)
def test_parameters_of_one_step(forward, baseline, params, error, words):
    fails(error, words, lambda: OneStep(forward, **params).fit(baseline))


def test_an_unknown_parameter_is_refused_and_nothing_is_set(forward):
    model = OneStep(forward)
    fails(ValueError, ["'lambda_'", "OneStep", "lam"], lambda: model.set_params(prior="laplace", lambda_=1.0))
    assert model.prior == "noser"


FRAMES = {
    "too few readings": (lambda b: b[:, :-1], ValueError, ["(3, 207)", "(frames, 208)"]),
    "frames in columns": (lambda b: b.T, ValueError, ["in columns", "transpose"]),
    "no frames": (lambda b: b[:0], ValueError, ["(0, 208)"]),
    "a number": (lambda b: 1.0, ValueError, ["()"]),
    "NaN": (lambda b: np.where(b == b[1, 2], np.nan, b), ValueError, ["[1, 2]", "nan", "missing='mask'"]),
    "infinite": (lambda b: np.where(b == b[1, 2], -np.inf, b), ValueError, ["[1, 2]", "-inf", "overload"]),
    "complex": (lambda b: b + 0j, TypeError, ["complex", "real part"]),
    "objects": (lambda b: b.astype(object), TypeError, ["object", "dtype=float"]),
    "masked": (lambda b: np.ma.masked_array(b), TypeError, ["masked"]),
}


@pytest.mark.parametrize("name", FRAMES)
def test_frames(forward, baseline, name):
    change, error, words = FRAMES[name]
    model = OneStep(forward)
    fails(error, ["'baseline'", *words], lambda: model.fit(change(baseline)))
    model.fit(baseline)
    fails(error, ["'frames'", *words], lambda: model.predict(change(baseline)))


def test_noise(forward, baseline):
    for noise, error in ((0.0, ValueError), (-1e-6, ValueError), (NAN, ValueError), ("2 uV", TypeError), ([1e-6, 1e-6], ValueError)):
        fails(error, ["'noise'", "in V"], lambda: OneStep(forward).fit(baseline, noise=noise))


def test_more_than_half_missing_is_refused(forward, baseline, frame):
    model = OneStep(forward, missing="mask").fit(baseline)
    frames = np.vstack([frame, frame])
    frames[1, :110] = np.nan
    fails(ValueError, ["row 1", "110 of 208", "50 %"], lambda: model.predict(frames))


def test_a_dead_baseline(forward):
    fails(ValueError, ["'baseline'", "zero"], lambda: OneStep(forward).fit(np.zeros(208)))
    fails(ValueError, ["'baseline'", "zero"], lambda: OneStep(forward, check_order=False).fit(np.zeros(208)))
    empty = np.full(208, np.nan)
    fails(ValueError, ["'baseline'", "missing everywhere"], lambda: OneStep(forward, missing="mask").fit(empty))
