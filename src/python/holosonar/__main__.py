"""The ``holosonar`` command: ``python -m holosonar``, and the script that pip installs."""

from __future__ import annotations

import signal
import sys

from ._holosonar import run_command


def main() -> int:
    """Runs the command with the arguments of the process.

    Returns
    -------
    int
        The exit status: 0 done; 1 I/O or memory; 2 the request or an input file is wrong; 3 a limit was missed; 130
        interrupted.
    """
    # The command has a handler of its own, which stores what is finished; Python's would raise afterwards.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return run_command(["holosonar", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
