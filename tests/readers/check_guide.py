#!/usr/bin/env python3
"""Runs the examples of the README and of the guide, in reading order and in one folder, and compares what they print.

    check_guide.py BINARY FOLDER
    check_guide.py --prove BINARY FOLDER

FOLDER is made, and must not hold anything yet. In a block marked `sh`, every line that calls `holosonar` (or `cargo run
--release --`, which stands for it) is run with BINARY and must succeed; other lines are for people. A block marked
`sh not-run` has placeholders. A block marked `python` is run by this interpreter, without warnings. A block marked
`text output` must stand in what the block before it printed, line by line; numbers may differ by 1 %, since another
processor may round otherwise, and a line of three dots stands for any lines.

With --prove, copies of the examples are broken, one way at a time, and each must be noticed.
"""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```([^\n]*)\n(.*?)^```$", re.M | re.S)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def documents():
    """The README and the chapters, in the order in which the module lists them."""
    module = (REPOSITORY / "src/guide.rs").read_text(encoding="utf-8")
    chapters = re.findall(r'include_str!\("(guide/\w+\.md)"\)', module)
    return [REPOSITORY / "README.md", *(REPOSITORY / "src" / chapter for chapter in chapters)]


def commands(block):
    """The lines of a shell block that call the program, those continued by a backslash joined."""
    for line in block.replace("\\\n", " ").splitlines():
        line = re.sub(r"^cargo run --release -- ", "holosonar ", line.strip())
        if line.startswith("holosonar "):
            yield line


def run(arguments, folder, path):
    environment = {**os.environ, "PATH": path, "NO_COLOR": "1"}
    return subprocess.run(arguments, cwd=folder, env=environment, capture_output=True, text=True)


def alike(expected, printed):
    """Whether two lines agree: words exactly, numbers to 1 %."""
    if NUMBER.sub("0", expected).split() != NUMBER.sub("0", printed).split():
        return False
    pairs = zip(map(float, NUMBER.findall(expected)), map(float, NUMBER.findall(printed)))
    return all(abs(a - b) <= 0.01 * abs(a) + 1e-12 for a, b in pairs)


def missing(sample, printed):
    """The first line of a sample that the output lacks at its place; None if it has them all."""
    lines, place, adjoining = printed.splitlines(), 0, False
    for expected in sample.splitlines():
        if expected.strip() == "...":
            adjoining = False
            continue
        matches = (i for i in range(place, len(lines)) if alike(expected, lines[i]))
        found = next(matches, None)
        if found is None or (adjoining and found != place):
            return expected
        place, adjoining = found + 1, True
    return None


def check(document, text, folder, path):
    """Runs the examples of one document; gives how many there were and what went wrong."""
    printed, count, faults = None, 0, []
    for match in BLOCK.finditer(text):
        info, block = match[1].strip(), match[2]
        place = f"{document}:{text[: match.start()].count(chr(10)) + 1}"
        if info == "sh":
            outputs = []
            for command in commands(block):
                ran = run(["bash", "-c", command], folder, path)
                count += 1
                outputs.append(ran.stdout)
                print(f"{place}: {command}: exit status {ran.returncode}", flush=True)
                if ran.returncode != 0:
                    faults.append(f"{place}: `{command}` failed:\n{ran.stdout}{ran.stderr}")
            printed = "".join(outputs)
        elif info == "python":
            ran = run([sys.executable, "-W", "error", "-c", block], folder, path)
            count += 1
            printed = ran.stdout
            print(f"{place}: {ran.stdout.strip()}", flush=True)
            if ran.returncode != 0:
                faults.append(f"{place}: the example failed:\n{block}\n{ran.stderr}")
        elif info == "text output":
            line = missing(block, printed) if printed is not None else "(there is no example before it)"
            count += 1
            if line is not None:
                faults.append(f"{place}: the program does not print\n{line}\nbut\n{printed}")
        elif info not in ("text", "toml", "sh not-run") and not info.startswith("rust"):
            faults.append(f"{place}: a block marked `{info}` is none that is known here")
    return count, faults


def prepare(binary, folder):
    """A folder with the scenes, and a PATH on which `holosonar` is the binary."""
    folder.mkdir(parents=True)
    (folder / "scenes").symlink_to(REPOSITORY / "scenes")
    names = folder / ".bin"
    names.mkdir()
    (names / "holosonar").symlink_to(binary)
    return f"{names}{os.pathsep}{os.environ['PATH']}"


def prove(binary, folder):
    """Breaks examples and sees that each is noticed; the sound one before them must pass."""
    sound = (
        "```sh\nholosonar image scenes/point.toml -o out/point\n```\n\n"
        "```text output\nreflectors  1\n...\ngrid        41 x 41 x 51 voxels\n```\n\n"
        "```python\nimport json\nassert json.load(open('out/point/report.json'))['reflectors'] == 1\n```\n"
    )
    with tempfile.TemporaryDirectory() as trial:
        path = prepare(binary, Path(trial) / "shape")
        shape = run(["bash", "-c", "holosonar image scenes/point.toml -o out/point"], Path(trial) / "shape", path)
        grid = next(line for line in shape.stdout.splitlines() if line.startswith("grid "))
    sound = sound.replace("grid        41 x 41 x 51 voxels", grid)
    broken = {
        "a command that fails": sound.replace("point.toml -o", "points.toml -o"),
        "an option that is gone": sound.replace("-o out/point", "--out out/point"),
        "a word that is not printed": sound.replace("reflectors  1", "points  1"),
        "a number that is not printed": sound.replace("reflectors  1", "reflectors  2"),
        "an assertion": sound.replace("== 1", "== 2"),
        "a warning": sound.replace("import json", "import json, warnings\nwarnings.warn('x')"),
        "a mark that is not known": sound.replace("```python", "```pyhton"),
    }
    unnoticed = 0
    for number, (name, text) in enumerate({"none": sound, **broken}.items()):
        trial = folder / str(number)
        path = prepare(binary, trial)
        _, faults = check(name, text, trial, path)
        wrong = bool(faults) if name == "none" else not faults
        unnoticed += wrong
        print(f"{name}: {'WRONG' if wrong else 'as it should be'}")
        if wrong:
            print("\n".join(faults))
    sys.exit(1 if unnoticed else 0)


def main():
    arguments = [argument for argument in sys.argv[1:] if argument != "--prove"]
    if len(arguments) != 2:
        sys.exit(__doc__)
    binary, folder = Path(arguments[0]).resolve(), Path(arguments[1])
    if "--prove" in sys.argv:
        prove(binary, folder)
    path = prepare(binary, folder)
    total, faults = 0, []
    for document in documents():
        name = document.relative_to(REPOSITORY)
        count, wrong = check(name, document.read_text(encoding="utf-8"), folder, path)
        total, faults = total + count, faults + wrong
    for fault in faults:
        print(f"\nFAILED {fault}")
    print(f"{total - len(faults)} examples passed, {len(faults)} failed")
    sys.exit(1 if faults or total < 30 else 0)


if __name__ == "__main__":
    main()
