"""Runs the tutorials, and compares what they print with their pages in docs/tutorials/python.

    python python/tutorials/run.py [NAME...]             in a temporary folder
    python python/tutorials/run.py --write [NAME...]     the pages' output and pictures are replaced

A tutorial is NAME.py, its page NAME.md with '-' in the place of '_'. The page has the whole script except its first docstring
and the output, except lines with times; both are compared. Needs matplotlib; tutorials whose packages are missing are named and
left out, an error with --all. real_tanks needs the folder of recordings of others, TACTUS_DATA or ../shared/data; it is left out
without, an error with TACTUS_REQUIRE_DATA=1.
"""

import argparse
import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
PROJECT = HERE.parents[1]
PAGES = PROJECT / "docs" / "tutorials" / "python"

#: What a tutorial needs besides numpy, and the files that are made before it runs: arguments of tactus-lab.
MODULES = {
    "compare_pyeit": ["pyeit"],
    "network_from_pytorch": ["torch", "onnx", "onnxscript", "onnxruntime"],
    "own_mesh": ["scipy"],
    "sessions": ["pandas"],
}
PREPARED = {
    "drift": ["scene", "run", "month", "--every", "3600", "--frames", "241", "--logbook", "month"],
    "own_recording": ["scene", "run", "paper-test1", "--every", "60", "--frames", "5", "--out", "frames"],
    "paper_test1": ["scene", "run", "paper-test1", "--every", "60", "--frames", "17", "--out", "frames"],
    "sessions": ["scene", "run", "month", "--every", "3600", "--frames", "721", "--logbook", "month"],
}
ARGUMENTS = {
    "drift": ["month/scene_month_1.tactus"],
    "own_recording": ["frames"],
    "paper_test1": ["frames"],
    "real_tanks": [os.environ.get("TACTUS_DATA") or str(PROJECT.parent / "shared" / "data")],
    "sessions": ["month/scene_month_1.tactus"],
}

# the output has times in some lines, which differ from run to run
TIMED = re.compile(r"^time of .*$", re.MULTILINE)


def code(script):
    """The script without its first docstring."""
    text = script.read_text()
    docstring = ast.parse(text).body[0]
    return "\n".join(text.splitlines()[docstring.end_lineno :]).strip() + "\n"


def laboratory():
    """The program tactus-lab as the start of a command."""
    built = os.environ.get("TACTUS_LAB") or shutil.which("tactus-lab")
    if built:
        return [built]
    manifest = ["--manifest-path", str(PROJECT / "Cargo.toml")]
    return ["cargo", "run", "--quiet", *manifest, "--package", "tactus-lab", "--bin", "tactus-lab", "--"]


def run(name, folder):
    """The output of a tutorial; its pictures lie in the folder."""
    environment = {**os.environ, "MPLBACKEND": "Agg", "PYTHONWARNINGS": "error"}
    if name in PREPARED:
        subprocess.run([*laboratory(), *PREPARED[name]], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    command = [sys.executable, str(HERE / f"{name}.py"), *ARGUMENTS.get(name, [])]
    done = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True)
    if done.returncode != 0:
        raise SystemExit(f"{name}.py failed with exit code {done.returncode}")
    return done.stdout


#: A block of a page: its language and its text. Each language has one block.
BLOCK = re.compile(r"^```(python|text)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def compare(name, script, output, write):
    page = PAGES / f"{name.replace('_', '-')}.md"
    text = page.read_text()
    shown = dict(BLOCK.findall(text))
    made = {"python": script, "text": output}
    if write:
        page.write_text(BLOCK.sub(lambda found: f"```{found[1]}\n{made[found[1]].rstrip()}\n```", text))
        return
    for language in made:
        if TIMED.sub("", shown[language]).strip() != TIMED.sub("", made[language]).strip():
            raise SystemExit(
                f"{page.name}: its block '{language}' differs from {name}.py:\n{made[language]}\nrun.py --write {name} replaces it"
            )


def missing(name):
    """The packages that a tutorial lacks here."""
    import importlib.util

    return [module for module in ["matplotlib", *MODULES.get(name, [])] if importlib.util.find_spec(module) is None]


def main():
    every = sorted(script.stem for script in HERE.glob("*.py") if script.stem != "run")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"by default all: {', '.join(every)}")
    parser.add_argument("--write", action="store_true", help="replace the output and the pictures of the pages")
    parser.add_argument("--all", action="store_true", help="a missing package is an error")
    options = parser.parse_args()
    unknown = set(options.names) - set(every)
    if unknown:
        parser.error(f"there is no tutorial {', '.join(sorted(unknown))}; the tutorials are {', '.join(every)}")
    for name in options.names or every:
        lacking = missing(name)
        if lacking:
            print(f"{name}: not run, without {', '.join(lacking)}")
            if options.all:
                raise SystemExit("install what is missing with pip")
            continue
        if name == "real_tanks" and not Path(*ARGUMENTS[name]).is_dir():
            print(f"{name}: not run, without the folder {ARGUMENTS[name][0]}")
            if os.environ.get("TACTUS_REQUIRE_DATA") == "1":
                raise SystemExit("name the folder in TACTUS_DATA")
            continue
        with tempfile.TemporaryDirectory() as folder:
            output = run(name, folder)
            compare(name, code(HERE / f"{name}.py"), output, options.write)
            pictures = sorted(Path(folder).glob("*.png"))
            if not pictures:
                raise SystemExit(f"{name}.py made no picture")
            if options.write:
                (PAGES / "pictures").mkdir(exist_ok=True)
                for picture in pictures:
                    shutil.copy(picture, PAGES / "pictures")
        print(f"{name}: as on its page")


if __name__ == "__main__":
    main()
