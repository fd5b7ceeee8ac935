#!/usr/bin/env python3
"""Runs the examples of the README and of the guide, in reading order and in one folder, and compares what they print.

    check_guide.py BINARY FOLDER
    check_guide.py --update BINARY FOLDER
    check_guide.py --prove BINARY FOLDER

FOLDER is made, and must not hold anything yet. In a block marked `sh`, every line that calls `holosonar` (or `cargo run
--release --`, which stands for it) is run with BINARY and must succeed; other lines are for people. A block marked
`sh not-run` has placeholders. A block marked `python` is run by this interpreter, without warnings. A block marked
`text output` is what the block before it printed, or its lines A to B if it is marked `text output A-B`; numbers may
differ by 1 % or by one in the last decimal, since another processor may round differently.

With --update, samples of output that differ are replaced by what is printed now. With --prove, copies of the examples
are broken, one way at a time, and each must be noticed.
"""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```([^\n]*)\n(.*?)^```$", re.M | re.S)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")


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


def near(expected, printed):
    """Whether two numbers agree to 1 %, or to one in the last decimal."""
    decimals = len(expected.partition(".")[2])
    slack = max(0.01 * abs(float(expected)), 10.0**-decimals if decimals else 0.0)
    return abs(float(expected) - float(printed)) <= slack * (1 + 1e-9)


def alike(expected, printed):
    """Whether two lines have the same words, and numbers that are near each other."""
    if NUMBER.sub("0", expected).split() != NUMBER.sub("0", printed).split():
        return False
    return all(map(near, NUMBER.findall(expected), NUMBER.findall(printed)))


def excerpt(printed, info):
    """The lines of an output that a sample with this mark shows."""
    lines = printed.splitlines()
    found = re.fullmatch(r"text output (\d+)-(\d+)", info)
    return lines[int(found[1]) - 1 : int(found[2])] if found else lines


def check(document, text, folder, path):
    """Runs the examples of one document; gives how many there were, what went wrong, and samples as they are now."""
    printed, count, faults, samples = None, 0, [], {}
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
        elif re.fullmatch(r"text output( \d+-\d+)?", info):
            count += 1
            shown, lines = block.splitlines(), excerpt(printed or "", info)
            if not lines or len(shown) != len(lines) or not all(map(alike, shown, lines)):
                now = "\n".join(lines)
                if lines:
                    samples[match.span(2)] = now + "\n"
                faults.append(f"{place}: the sample is not what is printed:\n{now}")
        elif info not in ("text", "toml", "sh not-run") and not info.startswith("rust"):
            faults.append(f"{place}: a block marked `{info}` is none that is known here")
    return count, faults, samples


def prepare(binary, folder):
    """A folder with the scenes, and a PATH on which `holosonar` is the binary."""
    folder.mkdir(parents=True)
    (folder / "scenes").symlink_to(REPOSITORY / "scenes")
    names = folder / ".bin"
    names.mkdir()
    (names / "holosonar").symlink_to(binary)
    return f"{names}{os.pathsep}{os.environ['PATH']}"


def prove(binary, folder):
    """Breaks examples and sees that each is noticed; the sound ones must pass."""
    sound = (
        "```sh\nholosonar info scenes/point.toml\nholosonar truth scenes/corner.toml -o truth.exr\n```\n\n"
        "```text output 3-3\nwrote truth.exr\n```\n\n"
        "```python\nimport os\nassert os.path.getsize('truth.exr') > 1000\n```\n"
    )
    with tempfile.TemporaryDirectory() as trial:
        path = prepare(binary, Path(trial) / "first")
        first = run(["bash", "-c", "holosonar info scenes/point.toml"], Path(trial) / "first", path)
    count = len(first.stdout.splitlines()) + 1
    sound = sound.replace("output 3-3", f"output {count - 1}-{count}")
    sound = sound.replace("wrote truth.exr", first.stdout.splitlines()[-1] + "\nwrote truth.exr")
    broken = {
        "a command that fails": sound.replace("scenes/corner.toml", "scenes/corners.toml"),
        "an option that is gone": sound.replace("-o truth.exr", "--out truth.exr"),
        "a word that is not printed": sound.replace("wrote truth", "made truth"),
        "a line that is not printed": sound.replace("wrote truth.exr", "wrote truth.exr\nwrote more"),
        "a line too few": sound.replace("\nwrote truth.exr\n", "\n"),
        "an assertion": sound.replace("> 1000", "> 10**9"),
        "a warning": sound.replace("import os\n", "import os, warnings\nwarnings.warn('x')\n"),
        "a mark that is not known": sound.replace("```python", "```pyhton"),
    }
    unnoticed = 0
    for number, (name, text) in enumerate({"none": sound, **broken}.items()):
        trial = folder / str(number)
        path = prepare(binary, trial)
        _, faults, _ = check(name, text, trial, path)
        wrong = text == sound and name != "none" or (bool(faults) if name == "none" else not faults)
        unnoticed += wrong
        print(f"broken by {name}: {'WRONG' if wrong else 'as it should be'}")
        if wrong:
            print("\n".join(faults))
    assert not alike("10 mm", "10.2 mm") and alike("10.0 mm", "10.01 mm") and not alike("10 mm", "10 m")
    sys.exit(1 if unnoticed else 0)


def main():
    arguments = [argument for argument in sys.argv[1:] if not argument.startswith("--")]
    if len(arguments) != 2 or not {"--update", "--prove"} >= set(sys.argv[1:]) - set(arguments):
        sys.exit(__doc__)
    binary, folder = Path(arguments[0]).resolve(), Path(arguments[1])
    if "--prove" in sys.argv:
        prove(binary, folder)
    path = prepare(binary, folder)
    total, faults = 0, []
    for document in documents():
        text = document.read_text(encoding="utf-8")
        count, wrong, samples = check(document.relative_to(REPOSITORY), text, folder, path)
        total, faults = total + count, faults + wrong
        if "--update" in sys.argv:
            for (start, end), sample in sorted(samples.items(), reverse=True):
                text = text[:start] + sample + text[end:]
            document.write_text(text, encoding="utf-8")
    for fault in faults:
        print(f"\nFAILED {fault}")
    print(f"{total - len(faults)} examples passed, {len(faults)} failed")
    sys.exit(1 if faults or total < 30 else 0)


if __name__ == "__main__":
    main()
