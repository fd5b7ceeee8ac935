"""The examples of the guide are checked by mypy as strictly as it can."""

import re
import subprocess
import sys

import pytest
from conftest import REPOSITORY


def examples():
    for document in ("src/guide/python.md", "README.md"):
        text = (REPOSITORY / document).read_text(encoding="utf-8")
        for number, block in enumerate(re.findall(r"^```python\n(.*?)^```$", text, re.M | re.S)):
            if "holosonar" in block:
                yield f"{document.replace('/', '_').removesuffix('.md')}_{number}", block


def mypy(folder):
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--cache-dir", folder / ".cache", folder]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder)


def test_examples_of_the_guide_have_types(tmp_path):
    pytest.importorskip("mypy")
    for name, block in examples():
        (tmp_path / f"{name}.py").write_text(block, encoding="utf-8")
    assert len(list(tmp_path.glob("*.py"))) > 6
    ran = mypy(tmp_path)
    assert ran.returncode == 0, ran.stdout


def test_mistakes_are_noticed(tmp_path):
    pytest.importorskip("mypy")
    (tmp_path / "wrong.py").write_text("import holosonar\nholosonar.reconstruct(3, method='fast')\n", encoding="utf-8")
    ran = mypy(tmp_path)
    assert ran.returncode == 1 and ran.stdout.count("error:") == 2, ran.stdout
