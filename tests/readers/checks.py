"""Counts checks and prints those that fail, for the programs of this folder whose checks have no place."""

import sys

passed = 0
failed = []


def check(what, holds, detail=""):
    """Counts one check and prints it if it fails."""
    global passed
    if holds:
        passed += 1
    else:
        failed.append(what)
        print(f"FAILED: {what} {detail}".rstrip(), flush=True)


def conclude():
    """Prints the counts, and exits with status 1 if a check failed or there was none."""
    print(f"{passed} passed, {len(failed)} failed")
    sys.exit(1 if failed or not passed else 0)
