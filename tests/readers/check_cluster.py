#!/usr/bin/env python3
"""Images a scene by a Dask cluster of several hosts, one of which loses the network in mid-run, and compares the bytes.

    check_cluster.py BINARY FOLDER

The hosts are network namespaces of this machine that share FOLDER, which is made, and must not hold anything yet: a
scheduler with a bridge, and two workers. The link of one worker is cut and mended twice: for as long as the scheduler
waits for a worker, so that its results come later, and for longer, so that its tasks are given to the other; a new worker
is started there then, as Slurm or Kubernetes would. Needs root and iproute2, and a Python with holosonar and distributed.
"""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from checks import check, conclude
from shared_job import compare, make, wait_for

#: Seconds without an answer after which the scheduler gives a worker up; Dask wants at least 11, and has 30 by default.
PATIENCE = 12

#: Runs the job in the scheduler's namespace, and says when the number of workers changes.
CLIENT = """
import json, sys, threading, time
from distributed import Client
import holosonar.distributed

address, run, output = sys.argv[1:]
ended = threading.Event()


def say(**what):
    print(json.dumps(what), flush=True)


def watch(client):
    told = None
    while not ended.is_set():
        found = len(client.scheduler_info(n_workers=-1)["workers"])
        if found != told:
            say(workers=found)
        told = found
        time.sleep(0.2)


if __name__ == "__main__":
    with Client(address, set_as_default=False) as client, Client(address, set_as_default=False) as other:
        client.wait_for_workers(2, timeout=60)
        watcher = threading.Thread(target=watch, args=[other])
        watcher.start()
        try:
            report = holosonar.distributed.image(
                run, output, client, parts=16, progress=lambda done, units: say(done=done, units=units)
            )
            say(accepted=report["accepted"])
            sys.stdin.readline()
        finally:
            ended.set()
            watcher.join()
"""


def ip(*words, check=True):
    return subprocess.run(["ip", *words], check=check, capture_output=True, text=True)


class Hosts:
    """Namespaces, of which the first is a bridge for the links of the others."""

    def __init__(self, names):
        self.names = [f"holosonar-{os.getpid()}-{name}" for name in names]
        self.addresses = {}

    def __enter__(self):
        (hub, *others) = self.names
        for name in self.names:
            ip("netns", "add", name)
            ip("-n", name, "link", "set", "lo", "up")
        ip("-n", hub, "link", "add", "bridge", "type", "bridge")
        for i, name in enumerate(others):
            ip("link", "add", f"port{i}", "netns", hub, "type", "veth", "peer", "name", "eth0", "netns", name)
            ip("-n", hub, "link", "set", f"port{i}", "master", "bridge", "up")
            ip("-n", name, "address", "add", f"10.77.0.{i + 2}/24", "dev", "eth0")
            ip("-n", name, "link", "set", "eth0", "up")
        ip("-n", hub, "address", "add", "10.77.0.1/24", "dev", "bridge")
        ip("-n", hub, "link", "set", "bridge", "up")
        return self

    def __exit__(self, *_):
        for name in self.names:
            ip("netns", "delete", name, check=False)

    def start(self, host, words, **options):
        """Starts a program in a namespace, in a session of its own."""
        words = ["ip", "netns", "exec", self.names[host], *map(str, words)]
        return subprocess.Popen(words, start_new_session=True, **options)

    def link(self, host, state):
        """Pulls or plugs a host's cable: neither side is told that the other is gone."""
        ip("-n", self.names[0], "link", "set", f"port{host - 1}", state)


def end(process):
    """Ends a program with all that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def units(folder):
    return len([name for name in os.listdir(folder) if name.endswith(".unit")]) if folder.is_dir() else 0


def scenario(hosts, folder, name, environment, longer):
    """One image, with a cut that is shorter or longer than the scheduler's patience; gives what the client said."""
    output = folder / name
    log = open(folder / f"{name}.log", "w")
    programs = []

    def start(host, words, **options):
        programs.append(hosts.start(host, words, env=environment, cwd=folder, stderr=log, **options))
        return programs[-1]

    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "tcp://10.77.0.1:8786", "--nthreads", "1"]
    scheduler = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "10.77.0.1", "--port", "8786"]
    try:
        start(0, scheduler, stdout=log)
        for host in (1, 2):
            # Whoever runs workers starts them again.
            again = 'while true; do "$@"; sleep 1; done'
            words = [*worker, "--host", f"10.77.0.{host + 1}"]
            start(host, ["bash", "-c", again, "worker", *words], stdout=log)
        client = start(
            0,
            [sys.executable, folder / "client.py", "tcp://10.77.0.1:8786", folder / "run.toml", output],
            stdin=subprocess.PIPE,
            stdout=open(folder / f"{name}.said", "w"),
        )

        def said():
            return [json.loads(line) for line in (folder / f"{name}.said").read_text().splitlines()]

        def counts():
            return [what["workers"] for what in said() if "workers" in what]

        wait_for("units", lambda: units(output) >= 3 or client.poll() is not None, 120)
        hosts.link(2, "down")
        cut = time.monotonic()
        if longer:
            wait_for("a worker is given up", lambda: counts()[-1:] == [1], 120)
        else:
            time.sleep(PATIENCE / 3)
        check(f"{name}: the image is not ready when the link is mended", not any("accepted" in what for what in said()))
        hosts.link(2, "up")
        seconds = time.monotonic() - cut
        wait_for("the image", lambda: any("accepted" in what for what in said()) or client.poll() is not None, 300)
        if longer:
            wait_for("a new worker", lambda: counts()[-1:] == [2], 120)
        with contextlib.suppress(BrokenPipeError):
            client.stdin.write(b"\n")
            client.stdin.flush()
        check(f"{name}: the client succeeds", client.wait(60) == 0)
        print(f"{name}: cut for {seconds:.1f} s; workers {counts()}", flush=True)
        return counts()
    finally:
        for program in programs:
            end(program)
        log.close()


def main():
    if os.geteuid() != 0 or shutil.which("ip") is None:
        print("SKIPPED: network namespaces need root and iproute2")
        return
    binary, folder = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    probe = f"holosonar-{os.getpid()}-probe"
    refused = ip("netns", "add", probe, check=False).stderr.strip()
    ip("netns", "delete", probe, check=False)
    if refused:
        print(f"SKIPPED: this system makes no network namespaces ({refused})")
        return
    environment = {
        **os.environ,
        "HOLOSONAR_BINARY": str(binary),
        "XDG_STATE_HOME": str(folder / "state"),
        "DASK_DISTRIBUTED__COMM__TIMEOUTS__TCP": f"{PATIENCE}s",
        "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": f"{PATIENCE}s",
    }
    make(binary, folder, 25.0, environment)
    (folder / "client.py").write_text(CLIENT)
    for name, longer in (("short", False), ("long", True)):
        with Hosts(["scheduler", "one", "two"]) as hosts:
            counts = scenario(hosts, folder, name, environment, longer)
        expected = [2, 1, 2] if longer else [2]
        check(f"{name}: the number of workers was {expected}", counts == expected, str(counts))
        compare(folder, name)
    conclude()


if __name__ == "__main__":
    main()
