"""Licences, sources and bans of every crate that a build takes, read from `cargo metadata`.

Every crate must come from the registry, allow a licence of the list below, and be none of those that are not wanted.
"""

import json
import re
import subprocess
import sys

# Permissive, and for code: none asks more than to be named.
ALLOWED = {
    "MIT", "Apache-2.0", "Apache-2.0 WITH LLVM-exception", "BSD-2-Clause", "BSD-3-Clause", "ISC", "Zlib", "BSL-1.0",
    "Unicode-3.0", "CC0-1.0", "0BSD", "Unlicense", "MIT-0", "BSD-1-Clause", "Bitstream-Vera",
}
# Libraries in C that would need a compiler and a system's packages.
BANNED = {"openssl-sys", "bzip2-sys", "lzma-sys", "zstd-sys", "libz-sys", "blas-sys", "netlib-src"}
REGISTRY = "registry+https://github.com/rust-lang/crates.io-index"


def allowed(expression):
    """Whether an SPDX expression can be met: one side of every OR, all sides of an AND."""
    expression = expression.strip()
    while expression.startswith("(") and closing(expression) == len(expression) - 1:
        expression = expression[1:-1].strip()
    for word, rule in ((" OR ", any), (" AND ", all)):
        parts = split(expression, word)
        if len(parts) > 1:
            return rule(allowed(part) for part in parts)
    return expression in ALLOWED


def closing(text):
    depth = 0
    for place, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return place
    return -1


def split(text, word):
    parts, depth, start = [], 0, 0
    for place, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0 and text.startswith(word, place):
            parts.append(text[start:place])
            start = place + len(word)
    return parts + [text[start:]]


def faults(package, own):
    if package["id"] in own:
        return []
    name = f"{package['name']} {package['version']}"
    licence = re.sub(r"\s*/\s*", " OR ", package["license"] or "")
    found = []
    if not allowed(licence):
        found.append(f"{name}: licence {licence or 'unknown'}")
    if package["source"] != REGISTRY:
        found.append(f"{name}: from {package['source']}")
    if package["name"] in BANNED:
        found.append(f"{name}: not wanted")
    return found


def main():
    assert allowed("MIT OR (GPL-3.0 AND Zlib)") and allowed("(MIT OR Apache-2.0) AND Unicode-3.0")
    assert not allowed("GPL-3.0") and not allowed("MIT AND GPL-3.0") and not allowed("")
    text = subprocess.run(["cargo", "metadata", "--format-version", "1", "--locked"], check=True, stdout=subprocess.PIPE)
    metadata = json.loads(text.stdout)
    own = set(metadata["workspace_members"])
    found = [fault for package in metadata["packages"] for fault in faults(package, own)]
    print("\n".join(found) or f"{len(metadata['packages']) - len(own)} crates: licences, sources and bans hold")
    sys.exit(bool(found))


main()
