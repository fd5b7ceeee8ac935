#!/usr/bin/env python3
"""Runs the Python examples of README.md, in order and in one interpreter each, in a folder with results.

    check_readme.py README.md FOLDER

FOLDER must hold what the examples read (`out/corner` and so on); what they write is left there.
"""

import re
import subprocess
import sys
from pathlib import Path


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    readme = Path(sys.argv[1]).read_text(encoding="utf-8")
    examples = re.findall(r"^```python\n(.*?)^```$", readme, re.M | re.S)
    failed = 0
    for number, example in enumerate(examples, 1):
        run = subprocess.run(
            [sys.executable, "-W", "error", "-c", example], cwd=sys.argv[2], capture_output=True, text=True
        )
        print(f"example {number}: {'ok' if run.returncode == 0 else 'FAILED'}")
        print(run.stdout, end="")
        if run.returncode != 0:
            failed += 1
            print(example)
            print(run.stderr)
    print(f"{len(examples) - failed} passed, {failed} failed")
    sys.exit(1 if failed or not examples else 0)


if __name__ == "__main__":
    main()
