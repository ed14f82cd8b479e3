"""Meshes and protocols of pyEIT, and the same results as pyEIT where its model of an electrode allows it."""

import numpy as np
import pytest

import tactus_eit.pyeit
from tactus_eit.pyeit import JAC, EITForward

pyeit_mesh = pytest.importorskip("pyeit.mesh")
pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
]


@pytest.fixture(scope="module", params=[(16, 1), (16, 8), (26, 1), (32, 8)], ids=str)
def problem(request):
    from pyeit.eit import fem, jac, protocol
    from pyeit.mesh.wrapper import PyEITAnomaly_Circle

    electrodes, distance = request.param
    mesh = pyeit_mesh.create(electrodes, h0=0.1)
    protocol = protocol.create(electrodes, dist_exc=distance, step_meas=1, parser_meas="std")
    pressed = pyeit_mesh.set_perm(mesh, anomaly=PyEITAnomaly_Circle(center=[0.5, 0.0], r=0.15, perm=3.0))
    theirs = fem.EITForward(mesh, protocol)
    return mesh, protocol, theirs, theirs.solve_eit(), theirs.solve_eit(perm=pressed.perm), jac


def test_forward_solution_and_jacobian_agree_with_pyeit(problem):
    mesh, protocol, theirs, before, _, _ = problem
    ours = EITForward(mesh, protocol)
    # an electrode of pyEIT is a point and ours has a length: that is the difference, largest where electrodes are two edges
    # of the mesh apart
    assert np.linalg.norm(ours.solve_eit() - before) < 0.1 * np.linalg.norm(before)
    jacobian, volts = ours.compute_jac()
    reference, _ = theirs.compute_jac()
    assert jacobian.shape == reference.shape
    np.testing.assert_array_equal(volts, ours.solve_eit())
    assert np.corrcoef(jacobian.ravel(), reference.ravel())[0, 1] > 0.99
    normalised, _ = ours.compute_jac(normalize=True)
    np.testing.assert_allclose(normalised, jacobian / np.abs(volts)[:, np.newaxis], rtol=1e-14)


def test_the_jacobian_is_minus_the_derivative(problem):
    mesh, protocol, *_ = problem
    ours = EITForward(mesh, protocol)
    perm = 1.0 + 0.2 * np.sin(np.arange(len(mesh.element)))
    direction = np.cos(np.arange(len(mesh.element)))
    step = 1e-5
    difference = (ours.solve_eit(perm + step * direction) - ours.solve_eit(perm - step * direction)) / (2.0 * step)
    product = -ours.compute_jac(perm)[0] @ direction
    assert np.abs(product - difference).max() < 1e-7 * np.abs(product).max()


@pytest.mark.parametrize("method", ["kotre", "lm", "dgn"])
def test_maps_agree_with_pyeit(problem, method):
    mesh, protocol, _, before, after, jac = problem
    reference = jac.JAC(mesh, protocol)
    ours = JAC(mesh, protocol)
    settings = dict(p=0.5, lamb=0.01, method=method, perm=1, jac_normalized=True)
    reference.setup(**settings)
    assert ours.setup(**settings) is ours
    expected = reference.solve(after, before, normalize=True)
    found = ours.solve(after, before, normalize=True)
    assert np.corrcoef(found, expected)[0, 1] > 0.98
    centres = mesh.elem_centers[:, :2]
    assert np.hypot(*(centres[found.argmax()] - [0.5, 0.0])) < 0.2


def test_the_matrix_is_that_of_the_formula(problem):
    mesh, protocol, _, before, after, _ = problem
    for method, weight in (("kotre", 0.3), ("lm", 1.0), ("dgn", 0.0)):
        ours = JAC(mesh, protocol).setup(p=0.3, lamb=0.01, method=method)
        square = ours.J.T @ ours.J
        expected = np.linalg.solve(square + 0.01 * np.diag(np.diag(square) ** weight), ours.J.T)
        np.testing.assert_allclose(ours.H, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
        frames = np.vstack([after, before])
        rows = ours.solve(frames, before)
        np.testing.assert_allclose(rows[:, 0], -expected @ (after - before), rtol=1e-5, atol=1e-6 * np.abs(rows).max())
        assert not rows[:, 1].any()
        np.testing.assert_allclose(ours.solve(after, before, log_scale=True), np.exp(rows[:, 0]) - 1.0)


def test_readings_at_driven_electrodes_and_nodes_that_are_not_used():
    from pyeit.eit import protocol

    mesh = pyeit_mesh.create(16, h0=0.2)
    fmmu = protocol.create(16, parser_meas=["meas_current", "fmmu"])
    volts = EITForward(mesh, fmmu).solve_eit()
    assert volts.shape == (256,)
    # a node more at the front, and every second triangle turned round
    element = mesh.element + 1
    element[::2] = element[::2][:, ::-1]
    more = pyeit_mesh.PyEITMesh(
        node=np.vstack([[[9.0, 9.0, 0.0]], mesh.node]), element=element, el_pos=mesh.el_pos + 1, ref_node=1
    )
    np.testing.assert_allclose(EITForward(more, fmmu).solve_eit(), volts, rtol=1e-9)


def test_what_does_not_fit_is_refused():
    from pyeit.eit import protocol

    mesh = pyeit_mesh.create(16, h0=0.2)
    pairs = protocol.create(16)
    with pytest.raises(TypeError, match="'mesh'.*no node.*PyEITMesh"):
        JAC(None, pairs)
    with pytest.raises(TypeError, match="'protocol'.*no ex_mat"):
        JAC(mesh, None)
    with pytest.raises(ValueError, match="el_pos.*outline"):
        inner = int(np.hypot(*mesh.node[:, :2].T).argmin())
        JAC(pyeit_mesh.PyEITMesh(node=mesh.node, element=mesh.element, el_pos=np.array([0, 1, inner])), pairs)
    with pytest.raises(ValueError, match="triangles"):
        JAC(pyeit_mesh.PyEITMesh(node=mesh.node, element=np.array([[0, 1, 2, 3]])), pairs)
    with pytest.raises(ValueError, match="electrode"):
        JAC(mesh, protocol.create(32))
    with pytest.raises(TypeError, match="'perm'.*complex"):
        JAC(mesh, pairs).setup(perm=1.0 + 1.0j)
    with pytest.raises(ValueError, match="'method'.*kotre"):
        JAC(mesh, pairs).setup(method="best")
    with pytest.raises(ValueError, match="'lamb'.*above 0"):
        JAC(mesh, pairs).setup(lamb=0.0)
    with pytest.raises(RuntimeError, match="setup"):
        JAC(mesh, pairs).solve(np.ones(208), np.ones(208))
    jac = JAC(mesh, pairs).setup()
    with pytest.raises(ValueError, match=r"'v1'.*\(207,\)"):
        jac.solve(jac.v0[1:], jac.v0)
    with pytest.raises(ValueError, match="'v0'.*0"):
        jac.solve(jac.v0, np.zeros(208), normalize=True)


def test_a_missing_reading_is_refused_with_what_does_without():
    from pyeit.eit import protocol

    mesh, pairs = pyeit_mesh.create(16, h0=0.2), protocol.create(16, dist_exc=1, step_meas=1, parser_meas="std")
    jac = JAC(mesh, pairs).setup()
    frame = jac.v0.copy()
    frame[17] = np.nan
    with pytest.raises(ValueError, match=r"'v1'.*missing.*pyeit\.forward.*missing='mask'"):
        jac.solve(frame, jac.v0)
    model = tactus_eit.OneStep(tactus_eit.pyeit.forward(mesh, pairs), missing="mask", current=1.0).fit(jac.v0)
    assert np.isfinite(model.predict(frame)).all() and model.masked_.tolist() == [1]


def test_other_methods_take_the_objects_of_pyeit(problem):
    mesh, protocol, _, before, after, _ = problem
    forward = tactus_eit.pyeit.forward(mesh, protocol)
    change = tactus_eit.OneStep(forward, current=1.0).fit(before).predict(after)
    centroids = forward.mesh.centroids[forward.mesh.region]
    weight = np.where(change > 0.5 * change.max(), change, 0.0) * forward.mesh.areas[forward.mesh.region]
    assert np.hypot(*(weight @ centroids / weight.sum() - [0.5, 0.0])) < 0.1


def test_an_example_of_pyeit_runs_with_one_changed_import():
    """examples/eit_dynamic_jac.py of pyEIT 1.2.4, less its plots; the import of jac is the one that changed."""
    import pyeit.eit.protocol as protocol
    import pyeit.mesh as mesh
    from pyeit.eit.fem import EITForward
    from pyeit.eit.interp2d import sim2pts
    from pyeit.mesh.wrapper import PyEITAnomaly_Circle

    import tactus_eit.pyeit as jac

    n_el = 16
    mesh_obj = mesh.create(n_el, h0=0.1)
    pts, tri = mesh_obj.node, mesh_obj.element
    anomaly = PyEITAnomaly_Circle(center=[0.5, 0], r=0.1, perm=1000.0)
    mesh_new = mesh.set_perm(mesh_obj, anomaly=anomaly)
    protocol_obj = protocol.create(n_el, dist_exc=8, step_meas=1, parser_meas="std")
    fwd = EITForward(mesh_obj, protocol_obj)
    v0 = fwd.solve_eit()
    v1 = fwd.solve_eit(perm=mesh_new.perm)
    eit = jac.JAC(mesh_obj, protocol_obj)
    eit.setup(p=0.5, lamb=0.01, method="kotre", perm=1, jac_normalized=True)
    ds = eit.solve(v1, v0, normalize=True)
    ds_n = sim2pts(pts, tri, np.real(ds))
    assert np.hypot(*(pts[ds_n.argmax(), :2] - [0.5, 0.0])) < 0.2
    assert tactus_eit.pyeit.JAC is jac.JAC
