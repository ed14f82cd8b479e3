"""Times and memory of tactus_eit, compared with pyEIT, scipy and the Rust engine on the same triangles, as tables in Markdown.

    python benchmarks/compare.py [--triangles 1000 10000 40000] [--electrodes 16 26 32] [--limit 120] [--gigabytes 6]

Needs pyeit, scipy, and Rust for the last table; EIDORS where octave is installed and EIDORS_PATH names its folder. The mesh is a
disc. pyEIT has an electrode at one node; scipy (the project's reference for it, SuperLU), EIDORS and tactus_eit have the complete
electrode model on some edges. Works:

- forward: all readings of one conductance, assembly included
- jacobian: derivatives of all readings by the conductance of all triangles, with the forward solution it needs
- set-up: everything from nodes and triangles with readings of the empty tank to a method that makes maps; one-step, one strength for
  all frames. tactus_eit also checks the mesh, compares the readings with the model, and chooses the strength from the noise; EIDORS
  makes the first map, too
- frame: one map; not of EIDORS, which in Octave prepares each anew
- memory: the most that the four works took above what the process had with its mesh

Each engine is a process of its own with one thread, and works in turns with the others. A time is the processor time of a call (on a quiet
machine its duration, and hardly more on a busy one), the shortest of several. A turn that takes longer than --limit seconds of wall time,
or needs more than --gigabytes, ends that engine for this mesh.
"""

import argparse
import importlib.util
import os
import platform
import resource
import select
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from importlib.metadata import version
from pathlib import Path

import numpy as np

PYTHON = Path(__file__).resolve().parents[1]
REFERENCE = PYTHON.parent / "tomography" / "eit" / "examples" / "scipy_reference.py"
WORKS = ("forward", "jacobian", "set-up", "frame")
#: Turns of each engine at most, and seconds of processor time after which it has no more.
TURNS, ENOUGH = 5, 3.0
#: Calls of a turn at most, and seconds after which there are no more: as in examples/times.rs.
CALLS, TURN = 10, 0.1


def disc(electrodes, triangles):
    """Fineness and mesh of a disc with about this number of triangles."""
    import tactus_eit

    fineness = 1.0
    for _ in range(3):
        mesh = tactus_eit.Mesh.disc(electrodes=electrodes, fineness=fineness)
        # 0.25 to 8 are possible
        fineness = round(float(np.clip(fineness * np.sqrt(triangles / len(mesh.triangles)), 0.25, 8.0)), 3)
    return fineness, tactus_eit.Mesh.disc(electrodes=electrodes, fineness=fineness)


# --- one engine in a process of its own: a function that makes its works, from the mesh and two frames


def ours(mesh, protocol, baseline, frame):
    import tactus_eit

    forward, made = tactus_eit.Forward(mesh, protocol), {}

    def setup(check=True):
        # a mesh keeps its analysis: a new one has none
        fresh = tactus_eit.Mesh(mesh.nodes, mesh.triangles, mesh.electrodes)
        again = tactus_eit.Forward(fresh, protocol, mesh.contact)
        model = tactus_eit.OneStep(again, lam="noise", sigma0=mesh.sigma0, check_order=check)
        made["model"] = model.fit(baseline, noise=2e-6)

    return {
        "forward": lambda: forward.solve(mesh.sigma0),
        "jacobian": lambda: forward.jacobian(mesh.sigma0),
        "set-up": setup,
        "set-up without check": lambda: setup(check=False),
        "frame": lambda: made["model"].predict(frame),
    }


def pyeit(mesh, protocol, baseline, frame):
    import pyeit.eit.jac
    import pyeit.eit.protocol
    import pyeit.mesh
    from pyeit.eit.fem import EITForward

    points = np.array([int(edges[len(edges) // 2, 0]) for edges in mesh.electrodes])
    theirs = pyeit.mesh.PyEITMesh(node=mesh.nodes, element=mesh.triangles, perm=mesh.sigma0, el_pos=points)
    pairs = pyeit.eit.protocol.create(len(points))
    assert pairs.n_meas_tot == len(protocol)
    forward, made = EITForward(theirs, pairs), {}

    def setup():
        made["model"] = pyeit.eit.jac.JAC(theirs, pairs)
        made["model"].setup(p=0.5, lamb=0.01, method="kotre")

    return {
        "forward": lambda: forward.solve_eit(mesh.sigma0),
        "jacobian": lambda: forward.compute_jac(mesh.sigma0),
        "set-up": setup,
        "frame": lambda: made["model"].solve(frame, baseline),
    }


def scipy(mesh, protocol, baseline, frame):
    from scipy.linalg import solve

    spec = importlib.util.spec_from_file_location("scipy_reference", REFERENCE)
    reference = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reference)
    edges = [(number, *pair) for number, pairs in enumerate(mesh.electrodes) for pair in pairs]
    pairs = np.hstack([protocol.inject, protocol.measure])

    def sheet():
        return reference.Sheet(mesh.nodes, mesh.triangles, edges, mesh.contact, pairs)

    kept, made = sheet(), {}

    def setup():
        # NOSER in the space of the readings
        fresh = sheet()
        jacobian = 1e-3 * fresh.jacobian(fresh.fields(mesh.sigma0)) * mesh.sigma0
        prior = 1.0 / np.sqrt((jacobian**2).sum(axis=0))
        weighted = jacobian * prior
        gram = weighted @ weighted.T
        gram[np.diag_indices_from(gram)] += 1e-3 * np.trace(gram) / len(gram)
        made["matrix"] = solve(gram, weighted, assume_a="pos").T

    return {
        "forward": lambda: kept.readings(kept.fields(mesh.sigma0)),
        "jacobian": lambda: kept.jacobian(kept.fields(mesh.sigma0)),
        "set-up": setup,
        "frame": lambda: made["matrix"] @ (frame - baseline),
    }


ENGINES = {"pyEIT": pyeit, "scipy": scipy, "tactus_eit": ours}
#: Not in Python: eidors_times.m.
EIDORS = "EIDORS"


def eidors_is_there():
    return shutil.which("octave") is not None and os.path.isdir(os.environ.get("EIDORS_PATH", ""))


def most_memory():
    """The most memory that this process has had so far, bytes."""
    (line,) = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")]
    return 1024 * int(line.split()[1])


def problem(electrodes, fineness):
    """Mesh, protocol, and the readings of the empty tank and of a frame."""
    import tactus_eit

    mesh, protocol = tactus_eit.Mesh.disc(electrodes=electrodes, fineness=fineness), tactus_eit.Protocol.sheffield(electrodes)
    baseline = 1e-3 * tactus_eit.Forward(mesh, protocol).solve(mesh.sigma0)
    return mesh, protocol, baseline, baseline * (1.0 + 1e-3 * np.sin(np.arange(len(baseline))))


def case_of_eidors(path, electrodes, fineness):
    """Writes the same problem for eidors_times.m, counted from 1."""
    from scipy.io import savemat

    mesh, protocol, baseline, frame = problem(electrodes, fineness)
    nodes = np.empty(electrodes, dtype=object)
    nodes[:] = [np.unique(edges) + 1.0 for edges in mesh.electrodes]
    # by injection, as the readings of EIDORS are
    order = np.lexsort((protocol.inject[:, 1], protocol.inject[:, 0]))
    savemat(path, {
        "nodes": mesh.nodes, "elems": mesh.triangles + 1.0, "electrodes": nodes, "contact": mesh.contact,
        "inject": protocol.inject[order] + 1.0, "measure": protocol.measure[order] + 1.0, "conductance": mesh.sigma0[:, np.newaxis],
        "baseline": 1e3 * baseline[order], "frame": 1e3 * frame[order],
    })  # fmt: skip


def serve(engine, electrodes, fineness, gigabytes):
    """Answers each line of standard input, a work, with its shortest time of a turn, s; 'memory' with the bytes it took."""
    resource.setrlimit(resource.RLIMIT_AS, (int(gigabytes * 1e9), resource.RLIM_INFINITY))
    warnings.simplefilter("ignore")
    works = ENGINES[engine](*problem(electrodes, fineness))
    before = most_memory()
    for line in sys.stdin:
        work = line.strip()
        if work == "memory":
            print(most_memory() - before, flush=True)
            continue
        times = []
        try:
            while len(times) < CALLS and sum(times) < TURN:
                begin = time.process_time()
                works[work]()
                times.append(time.process_time() - begin)
        except MemoryError:
            print("memory", flush=True)
            return
        print(min(times), flush=True)


# --- the engines side by side


class Engine:
    """A process that does works; ``why`` says why it does no more."""

    def __init__(self, command, limit, more=None):
        environment = {**os.environ, **(more or {}), **{f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "RAYON")}}
        self.process = subprocess.Popen(
            [str(word) for word in command], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.limit, self.why = limit, None

    def ask(self, work):
        """The answer to a work, a number; None where there is none."""
        if self.why:
            return None
        try:
            self.process.stdin.write(work + "\n")
            self.process.stdin.flush()
            ready, _, _ = select.select([self.process.stdout], [], [], self.limit)
            answer = self.process.stdout.readline().strip() if ready else "slow"
        except BrokenPipeError:
            answer = ""
        if answer == "-":
            return None
        if answer in ("slow", "memory", ""):
            self.why = {"slow": f"> {self.limit:g} s", "memory": "memory"}.get(answer, "failed")
            self.process.kill()
            if not answer:
                sys.stderr.write(self.process.stderr.read())
            return None
        return float(answer)

    def close(self):
        self.process.stdin.close()
        self.process.kill()
        self.process.wait()


def shortest(engines, work):
    """The shortest time of each engine by name, s; the turns of the engines alternate."""
    best, spent = {}, dict.fromkeys(engines, 0.0)
    for _ in range(TURNS):
        for name, engine in engines.items():
            if spent[name] < ENOUGH and (taken := engine.ask(work)) is not None:
                best[name] = min(taken, best.get(name, np.inf))
                spent[name] += taken
    return best


def measured(electrodes, triangles, options):
    """Number of triangles, works by name with the time of each engine, memory of each, and why an engine gave up."""
    fineness, mesh = disc(electrodes, triangles)
    here = [sys.executable, __file__, "--gigabytes", options.gigabytes, "--serve"]
    engines = {name: Engine([*here, name, electrodes, fineness], options.limit) for name in options.engines if name != EIDORS}
    case = tempfile.NamedTemporaryFile(suffix=".mat")
    if EIDORS in options.engines:
        case_of_eidors(case.name, electrodes, fineness)
        octave = ["octave", "--no-gui", "--norc", "--quiet", Path(__file__).with_name("eidors_times.m")]
        engines[EIDORS] = Engine(octave, options.limit, {"EIDORS_CASE": case.name})
    rust = Engine([options.rust, electrodes, fineness], options.limit) if options.rust else None
    try:
        times = {work: shortest(engines, work) for work in WORKS}
        memory = {name: engine.ask("memory") for name, engine in engines.items()}
        beside = {}
        for work in WORKS if rust else ():
            mine = "set-up without check" if work == "set-up" else work
            rounds = [(engines["tactus_eit"].ask(mine), rust.ask(work)) for _ in range(TURNS)]
            pairs = [pair for pair in rounds if None not in pair]
            beside[work] = tuple(min(column) for column in zip(*pairs)) if pairs else None
    finally:
        case.close()
        for engine in [*engines.values(), *([rust] if rust else [])]:
            engine.close()
    why = {name: engine.why for name, engine in engines.items()}
    return len(mesh.triangles), times, memory, beside, why


def cell(value, ours, why):
    """A number and how often ours fits in it."""
    if value is None:
        return why or "-"
    return f"{digits(value)} ({digits(value / ours)})" if ours else digits(value)


def digits(value):
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def build():
    """The program that times the Rust engine."""
    cargo = ["cargo", "build", "--quiet", "--release", "--locked", "--features", "pyo3/extension-module", "--example", "times"]
    subprocess.run(cargo, cwd=PYTHON, check=True)
    return Path(os.environ.get("CARGO_TARGET_DIR", PYTHON / "target")) / "release" / "examples" / "times"


def main():
    there = ["pyEIT", "scipy", *([EIDORS] if eidors_is_there() else []), "tactus_eit"]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--triangles", type=int, nargs="+", default=[1000, 10000, 40000])
    parser.add_argument("--electrodes", type=int, nargs="+", default=[16, 26, 32])
    parser.add_argument("--limit", type=float, default=120.0, help="longest turn, s [%(default)s]")
    parser.add_argument("--gigabytes", type=float, default=6.0, help="most memory of one engine, of its address space [%(default)s]")
    parser.add_argument("--engines", nargs="+", choices=[*ENGINES, EIDORS], default=there, help="by default all that are there")
    parser.add_argument("--serve", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        engine, electrodes, fineness = options.serve
        return serve(engine, int(electrodes), float(fineness), options.gigabytes)
    # beside Python only
    options.rust = build() if "tactus_eit" in options.engines else None
    print(f"pyEIT {version('pyeit')}, scipy {version('scipy')}, numpy {np.__version__}, Python {platform.python_version()}, {platform.machine()}")
    print("\nShortest times in ms, memory in MB; in brackets how often that of tactus_eit fits in it.\n")
    others = [name for name in options.engines if name != "tactus_eit"]
    print(f"| {' | '.join(['triangles', 'electrodes', 'work', *others, 'tactus_eit'])} |\n|---:|---:|---|{'---:|' * (len(others) + 1)}", flush=True)
    rows = []
    for triangles in options.triangles:
        for electrodes in options.electrodes:
            count, times, memory, beside, why = measured(electrodes, triangles, options)
            table = {work: {name: 1e3 * taken for name, taken in each.items()} for work, each in times.items()}
            table["memory"] = {name: taken / 1e6 for name, taken in memory.items() if taken is not None}
            for work, taken in table.items():
                mine = taken.get("tactus_eit")
                cells = [*(cell(taken.get(name), mine, why[name]) for name in others), cell(mine, None, why.get("tactus_eit"))]
                print(f"| {count:,} | {electrodes} | {work} | {' | '.join(cells)} |", flush=True)
            rows += [(count, electrodes, work, *pair) for work, pair in beside.items() if pair]
    if not rows:
        return
    print("\nThe same calls through Python and in Rust, ms.\n")
    print("| triangles | electrodes | work | Python | Rust | ratio |\n|---:|---:|---|---:|---:|---:|")
    for count, electrodes, work, python, rust in rows:
        print(f"| {count:,} | {electrodes} | {work} | {digits(1e3 * python)} | {digits(1e3 * rust)} | {python / rust:.3f} |")


if __name__ == "__main__":
    main()
