"""Examples in docstrings run, and the stubs describe the module that was built."""

import doctest
import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "tactus_eit"
MODULES = ["tactus_eit", *(f"tactus_eit.{name}" for name in ("_native", "drift", "eidors", "estimators", "order", "pyeit", "record"))]


@pytest.mark.parametrize("name", MODULES)
def test_doctests(name):
    module = importlib.import_module(name)
    finder = doctest.DocTestFinder(exclude_empty=True)
    runner = doctest.DocTestRunner()
    tests = finder.find(module, name)
    if name == "tactus_eit._native":
        # classes written in Rust: the finder does not take them for the module's own
        members = {"Mesh": module.Mesh, "Protocol": module.Protocol, "Forward": module.Forward}
        parts = [*members.values(), module.Mesh.sheet, module.Mesh.disc, module.merit, module.likeness]
        parser = doctest.DocTestParser()
        tests = [parser.get_doctest(part.__doc__, {}, part.__name__, None, 0) for part in parts]
        assert all(test.examples for test in tests)
    for test in tests:
        runner.run(test)
    assert runner.summarize().failed == 0
    assert runner.tries > 0 or name in ("tactus_eit.eidors", "tactus_eit.record")


def test_stubs_agree_with_the_module():
    pytest.importorskip("mypy")
    done = subprocess.run(
        [sys.executable, "-m", "mypy.stubtest", "tactus_eit._native", "--ignore-disjoint-bases"],
        capture_output=True,
        text=True,
        env={**os.environ, "MYPY_FORCE_COLOR": "0"},
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_types_of_the_package():
    pytest.importorskip("mypy")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--config-file", str(PACKAGE.parent / "pyproject.toml"), str(PACKAGE)],
        capture_output=True,
        text=True,
        env={**os.environ, "MYPY_FORCE_COLOR": "0"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
