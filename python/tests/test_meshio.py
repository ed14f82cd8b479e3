"""Meshes that meshio has read."""

import numpy as np
import pytest

from tactus_eit import Forward
from tactus_eit import meshio as from_meshio

meshio = pytest.importorskip("meshio")


@pytest.fixture
def read(mesh, tmp_path):
    """A file of gmsh: each electrode a physical group of lines, triangles clockwise, one node without a triangle."""
    lines = np.vstack(mesh.electrodes) + 1
    tags = np.repeat(np.arange(1, 17), [len(edges) for edges in mesh.electrodes])
    points = np.vstack([[[9.0, 9.0]], mesh.nodes])
    data = {"gmsh:physical": [tags, np.full(len(mesh.triangles), 99)]}
    data["gmsh:geometrical"] = data["gmsh:physical"]
    made = meshio.Mesh(
        np.c_[points, np.zeros(len(points))],
        [("line", lines), ("triangle", mesh.triangles[:, ::-1] + 1)],
        cell_data=data,
        field_data={f"electrode {tag}": np.array([tag, 1]) for tag in range(1, 17)},
    )
    meshio.write(tmp_path / "tank.msh", made, file_format="gmsh22", binary=False)
    return meshio.read(tmp_path / "tank.msh")


NAMES = [f"electrode {number}" for number in range(1, 17)]


def test_mesh_of_a_file_of_gmsh(read, mesh, protocol):
    found = from_meshio.mesh(read, NAMES)
    assert found.nodes.shape == mesh.nodes.shape and found.triangles.shape == mesh.triangles.shape
    ours, theirs = (Forward(one, protocol, 1.0).solve(1e-3) for one in (mesh, found))
    np.testing.assert_allclose(theirs, ours, rtol=1e-9)
    turned = Forward(from_meshio.mesh(read, NAMES[1:] + NAMES[:1]), protocol, 1.0).solve(1e-3)
    assert np.abs(turned - ours).max() > 1e-6 * np.abs(ours).max()


def test_what_a_file_lacks_is_named(read):
    with pytest.raises(ValueError, match="no line has the name 'electrode 17'.*'electrode 1'"):
        from_meshio.mesh(read, ["electrode 17"])
    with pytest.raises(TypeError, match="'electrodes'.*list of names"):
        from_meshio.mesh(read, "electrode 1")
    with pytest.raises(TypeError, match="'read'.*str"):
        from_meshio.mesh("tank.msh", NAMES)
    with pytest.raises(ValueError, match="'read'.*line.*triangles"):
        from_meshio.mesh(meshio.Mesh(read.points, [("line", [[0, 1]])]), NAMES)
    bent = read.points.copy()
    bent[0, 2] = 1.0
    with pytest.raises(ValueError, match="no volumes"):
        from_meshio.mesh(meshio.Mesh(bent, [("triangle", [[0, 1, 2]])]), NAMES)
