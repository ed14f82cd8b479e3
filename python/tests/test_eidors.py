"""Structures of EIDORS in all forms in which scipy reads them."""

import json
import os
import shutil
import subprocess

import numpy as np
import pytest

import tactus_eit
from tactus_eit import Forward, Mesh, Protocol, eidors

io = pytest.importorskip("scipy.io")
sparse = pytest.importorskip("scipy.sparse")

AMPERES = 0.01


def structures(rows):
    """An array of structures for savemat, from dicts with the same keys."""
    array = np.zeros((1, len(rows)), dtype=[(name, object) for name in rows[0]])
    for at, row in enumerate(rows):
        for name, value in row.items():
            array[0, at][name] = value
    return array


def model_of(mesh, protocol, contact):
    """The fwd_model that EIDORS would have for a mesh: triangles clockwise, one node that no triangle has."""
    nodes = np.vstack([[[9.0, 9.0]], mesh.nodes])
    electrodes = [{"nodes": np.unique(edges) + 2.0, "z_contact": z} for edges, z in zip(mesh.electrodes, contact)]
    stimulation = []
    for pair in np.unique(protocol.inject, axis=0):
        rows = protocol.measure[(protocol.inject == pair).all(axis=1)]
        driven = np.zeros((protocol.electrodes, 1))
        driven[pair, 0] = [AMPERES, -AMPERES]
        sensed = np.zeros((len(rows), protocol.electrodes))
        sensed[np.arange(len(rows)), rows[:, 0]], sensed[np.arange(len(rows)), rows[:, 1]] = 1.0, -1.0
        stimulation.append({"stim_pattern": sparse.csc_matrix(driven), "meas_pattern": sparse.csc_matrix(sensed)})
    return {
        "nodes": nodes,
        "elems": mesh.triangles[:, ::-1] + 2.0,
        "electrode": structures(electrodes),
        "stimulation": structures(stimulation),
    }


@pytest.fixture(scope="module")
def contact():
    return np.linspace(0.5, 2.0, 16)


@pytest.fixture
def file(tmp_path, mesh, protocol, contact):
    io.savemat(tmp_path / "tank.mat", {"fmdl": model_of(mesh, protocol, contact)})
    return tmp_path / "tank.mat"


FORMS = [{}, {"simplify_cells": True}, {"struct_as_record": False}, {"struct_as_record": False, "squeeze_me": True}, {"squeeze_me": True}]


@pytest.mark.parametrize("form", FORMS)
def test_forward_model_of_a_file(file, mesh, protocol, contact, form):
    model = io.loadmat(file, **form)["fmdl"]
    forward = eidors.forward(model)
    assert eidors.current(model) == AMPERES
    # stimulations come in the order of the file
    expected = Forward(mesh, eidors.protocol(model), contact)
    assert sorted(map(tuple, np.hstack([forward.protocol.inject, forward.protocol.measure]))) == sorted(
        map(tuple, np.hstack([protocol.inject, protocol.measure]))
    )
    np.testing.assert_allclose(forward.solve(1e-3), expected.solve(1e-3), rtol=1e-12)
    assert forward.mesh.nodes.shape == mesh.nodes.shape
    np.testing.assert_allclose(forward.mesh.electrode_lengths, mesh.electrode_lengths, rtol=1e-12)


@pytest.fixture
def recorded(tmp_path, mesh, protocol, contact):
    """A file with fmdl, and vh.meas and vi.meas, which have a column for each frame."""
    case = Forward(mesh, protocol, contact)
    pressed = np.hypot(*(mesh.centroids - [0.05, 0.0]).T) < 0.03
    # stimulations are sorted by their electrodes in the file, and so are the readings
    order = np.lexsort((protocol.inject[:, 1], protocol.inject[:, 0]))
    sigma = [np.full(len(pressed), 1e-3), np.where(pressed, 0.5e-3, 1e-3), np.where(pressed, 0.8e-3, 1e-3)]
    volts = AMPERES * case.solve(sigma)[:, order]
    saved = {"fmdl": model_of(mesh, protocol, contact), "vh": {"meas": volts[:1].T}, "vi": {"meas": volts[1:].T}}
    io.savemat(tmp_path / "tank.mat", saved)
    return tmp_path / "tank.mat"


def maps_of(recorded):
    """As the manual shows it."""
    file = io.loadmat(recorded)
    forward = eidors.forward(file["fmdl"])
    model = tactus_eit.OneStep(forward, current=eidors.current(file["fmdl"])).fit(file["vh"]["meas"][0, 0].ravel(), noise=2e-6)
    return forward, model.predict(file["vi"]["meas"][0, 0].T)


def test_maps_of_the_voltages_of_a_file(recorded, mesh):
    forward, change = maps_of(recorded)
    assert change.shape == (2, len(mesh.triangles))
    found = forward.mesh.centroids[forward.mesh.region][change[0].argmin()]
    assert np.hypot(*(found - [0.05, 0.0])) < 0.03


@pytest.mark.parametrize("writer", ["scipy", "scipy, deflated", "octave"])
def test_tactus_lab_makes_the_same_maps_of_a_file(recorded, tmp_path, writer):
    built = os.environ.get("TACTUS_LAB")
    if not built:
        pytest.skip("TACTUS_LAB does not name tactus-lab")
    _, expected = maps_of(recorded)
    if writer == "octave":
        if shutil.which("octave") is None:
            pytest.skip("octave is not installed")
        script = "load tank.mat; vv = vi.meas; clear vi; save -v7 tank.mat"
        done = subprocess.run(["octave", "--quiet", "--no-gui", "--eval", script], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    elif writer == "scipy, deflated":
        read = io.loadmat(recorded)
        io.savemat(recorded, {name: read[name] for name in ("fmdl", "vh", "vi")}, do_compression=True)
    command = [built, "reconstruct", "--case", recorded, "--method", "one-step", "--noise-v", "2e-6", "--out", tmp_path / "maps.csv"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "maps.csv", delimiter=","), expected)


def test_tactus_lab_calibrates_with_a_file(tmp_path, mesh, protocol, contact):
    built = os.environ.get("TACTUS_LAB")
    if not built:
        pytest.skip("TACTUS_LAB does not name tactus-lab")
    forward = Forward(mesh, protocol, contact)
    presses = [(0.03 * np.cos(angle), 0.03 * np.sin(angle), 0.02, mass) for mass in (1.0, 2.0, 4.0) for angle in np.arange(6)]
    sigma = [np.ones(len(mesh.triangles))]
    for x, y, diameter, mass in presses:
        pressed = np.hypot(*(mesh.centroids - [x, y]).T) <= 0.5 * diameter
        sigma.append(np.where(pressed, 1.0 - 0.1 * mass, 1.0))
    # as in `recorded`
    order = np.lexsort((protocol.inject[:, 1], protocol.inject[:, 0]))
    volts = AMPERES * forward.solve(sigma)[:, order]
    variables = {"fmdl": model_of(mesh, protocol, contact), "vh": volts[:1].T, "vv": volts[1:].T}
    io.savemat(tmp_path / "tank.mat", variables)
    rows = [",".join(map(str, (number, *press))) for number, press in enumerate(presses, 1)]
    (tmp_path / "presses.csv").write_text("\n".join(["frame,x_m,y_m,diameter_m,mass_kg", *rows]) + "\n")
    command = [built, "calibrate", "--case", tmp_path / "tank.mat", "--out", tmp_path / "tank.toml", "--noise-v", "2e-6", "--json"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    calibration = json.loads(done.stdout)
    assert calibration["presses"] == len(presses) and calibration["rms"] < 0.1
    # the presses lie beside the file, and are needed
    (tmp_path / "presses.csv").unlink()
    done = subprocess.run([*command[:-1], "--force"], capture_output=True, text=True)
    assert done.returncode != 0 and "presses.csv" in done.stderr


def test_methods_of_the_classes_are_the_same(file, protocol):
    model = io.loadmat(file)["fmdl"]
    assert Mesh.from_eidors(model).hash == eidors.mesh(model).hash
    assert Protocol.from_eidors(model) == eidors.protocol(model) and len(Protocol.from_eidors(model)) == len(protocol)


def test_structures_that_octave_saves(tmp_path, mesh, protocol, contact):
    if shutil.which("octave") is None:
        pytest.skip("octave is not installed")
    io.savemat(tmp_path / "arrays.mat", {
        "nodes": mesh.nodes, "elems": mesh.triangles + 1.0, "z": contact, "inject": protocol.inject + 1.0, "measure": protocol.measure + 1.0,
        "owners": np.vstack([np.c_[np.full(len(np.unique(e)), k + 1.0), np.unique(e) + 1.0] for k, e in enumerate(mesh.electrodes)]),
    })  # fmt: skip
    script = """
        load arrays.mat
        fmdl.type = 'fwd_model'; fmdl.nodes = nodes; fmdl.elems = elems;
        for k = 1:16
            fmdl.electrode(k).nodes = owners(owners(:, 1) == k, 2)'; fmdl.electrode(k).z_contact = z(k);
        end
        pairs = unique(inject, 'rows');
        for k = 1:rows(pairs)
            own = measure(all(inject == pairs(k, :), 2), :); n = rows(own);
            fmdl.stimulation(k).stimulation = 'Amp';
            fmdl.stimulation(k).stim_pattern = sparse(pairs(k, :), [1 1], [0.01 -0.01], 16, 1);
            fmdl.stimulation(k).meas_pattern = sparse([1:n 1:n], own(:)', [ones(1, n) -ones(1, n)], n, 16);
        end
        save -v7 fmdl.mat fmdl
    """
    done = subprocess.run(["octave", "--quiet", "--no-gui", "--eval", script], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    model = io.loadmat(tmp_path / "fmdl.mat")["fmdl"]
    forward = eidors.forward(model)
    np.testing.assert_allclose(forward.solve(1e-3), Forward(mesh, forward.protocol, contact).solve(1e-3), rtol=1e-12)


def with_unit(model, unit):
    rows = [{"stim_pattern": one["stim_pattern"], "meas_pattern": one["meas_pattern"], "stimulation": unit} for one in model["stimulation"][0]]
    return {**model, "stimulation": structures(rows)}


@pytest.mark.parametrize("form", FORMS)
def test_the_current_is_in_the_unit_of_the_stimulation(tmp_path, mesh, protocol, contact, form):
    for unit, amperes in [("Amp", AMPERES), ("A", AMPERES), ("mA", 1e-3 * AMPERES)]:
        io.savemat(tmp_path / "unit.mat", {"fmdl": with_unit(model_of(mesh, protocol, contact), unit)})
        assert eidors.current(io.loadmat(tmp_path / "unit.mat", **form)["fmdl"]) == amperes
    io.savemat(tmp_path / "unit.mat", {"fmdl": with_unit(model_of(mesh, protocol, contact), "Volt")})
    with pytest.raises(ValueError, match=r"stimulation\(1\).stimulation is 'Volt'; expected 'Amp' or 'mA'"):
        eidors.current(io.loadmat(tmp_path / "unit.mat", **form)["fmdl"])


def test_what_a_model_lacks_is_named(mesh, protocol, contact):
    def broken(**changes):
        return {**model_of(mesh, protocol, contact), **changes}

    good = broken()
    for error, match, model in [
        (TypeError, "no field nodes", {}),
        (TypeError, "no field elems", {"nodes": mesh.nodes}),
        (TypeError, "model.electrode is a float", broken(electrode=1.0)),
        (ValueError, r"nodes has shape.*3\).*no volumes", broken(nodes=np.ones((5, 3)))),
        (ValueError, "elems has shape", broken(elems=np.ones((5, 4)))),
        (ValueError, "model.elems names node 0", broken(elems=good["elems"] - 2.0)),
        (ValueError, r"electrode\(1\) covers no edge", broken(electrode=structures([{"nodes": np.array([3.0]), "z_contact": 1.0}]))),
        (ValueError, "no finite real", broken(nodes=np.full((5, 2), np.nan))),
        (ValueError, "names 1 electrodes", broken(stimulation=structures([{"stim_pattern": np.eye(16)[0], "meas_pattern": np.eye(16)}]))),
    ]:
        with pytest.raises(error, match=match):
            eidors.forward(model)
    doubled = broken()
    doubled["stimulation"][0, 3]["stim_pattern"] = 2.0 * doubled["stimulation"][0, 3]["stim_pattern"]
    with pytest.raises(ValueError, match="0.01 to 0.02 A.*one for all"):
        tactus_eit.eidors.protocol(doubled)
