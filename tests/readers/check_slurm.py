#!/usr/bin/env python3
"""Images a scene by Slurm as the guide says, with tasks of arrays requeued in mid-run and by Dask, and compares the bytes.

    check_slurm.py BINARY FOLDER

A cluster of two nodes is started on this machine, with its files in FOLDER, which is made, and must not hold anything yet.
Its job scripts are those of the guide's chapter on interruption, with other paths and sizes. Needs root, a Python with
holosonar and distributed, and Debian's packages slurmctld, slurmd, slurm-client and munge, or others like them; their own
services and settings are not touched.
"""

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

from checks import check, conclude
from shared_job import compare, make, wait_for

REPOSITORY = Path(__file__).resolve().parents[2]

TOOLS = ["munged", "slurmctld", "slurmd", "sbatch", "scontrol", "squeue"]

CONFIGURATION = """
ClusterName=test
SlurmctldHost=localhost
SlurmctldPort=26817
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
ReturnToService=2
KillWait=5
StateSaveLocation={folder}/state_of_slurmctld
SlurmdSpoolDir={folder}/%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/%n.log
NodeName=one NodeHostname=localhost NodeAddr=127.0.0.1 Port=27001 CPUs=1
NodeName=two NodeHostname=localhost NodeAddr=127.0.0.1 Port=27002 CPUs=1
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def scripts(folder):
    """The guide's script of a task, its commands that submit it, and a job of Dask, for this folder and few tasks."""
    guide = (REPOSITORY / "src/guide/interruption.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```text\n(.*?)^```$", guide, re.M | re.S)

    def block(mark, *changes):
        (found,) = [block for block in blocks if mark in block]
        for old, new in [*changes, ("/shared/me", str(folder))]:
            check(f"the guide's block with {mark} has {old}", old in found)
            found = found.replace(old, new)
        return found

    small = ("--cpus-per-task=8", "--cpus-per-task=1")
    return {
        "work.sh": block("#SBATCH --array", ("--array=1-40 --requeue", "--array=1-6 --requeue"), small),
        "submit.sh": f"set -e\n{block('sbatch --parsable')}\necho $first $second\n",
        "dask.sh": block("dask scheduler", ("--ntasks=16", "--ntasks=2"), small),
        "image.py": block("scheduler_file=", ("/shared/me/out", "/shared/me/dask")),
    }


class Cluster:
    """Slurm's programs, started in a folder and ended together."""

    def __init__(self, folder):
        self.folder, self.programs = folder, []
        # Slurm's own programs find the others by the path.
        self.environment = {**os.environ, "SLURM_CONF": str(folder / "slurm.conf")}

    def start(self, name, *words):
        log = open(self.folder / f"{name}.out", "w")
        self.programs.append(subprocess.Popen(list(map(str, words)), env=self.environment, stdout=log, stderr=log))

    def __enter__(self):
        folder = self.folder
        (folder / "munge.key").write_bytes(os.urandom(128))
        (folder / "munge.key").chmod(0o600)
        (folder / "slurm.conf").write_text(CONFIGURATION.format(folder=folder))
        for made in ("state_of_slurmctld", "one", "two"):
            (folder / made).mkdir()
        files = [f"--{kind}-file={folder}/munge.{kind}" for kind in ("key", "pid", "log", "seed")]
        self.start("munged", "munged", "--foreground", "--force", f"--socket={folder}/munge.socket", *files)
        wait_for("munge", (folder / "munge.socket").exists, 60)
        self.start("slurmctld", "slurmctld", "-D")
        for node in ("one", "two"):
            self.start(f"slurmd_{node}", "slurmd", "-D", "-N", node)
        wait_for("two nodes", lambda: self.text("sinfo", "-h", "-o", "%D %t").split() == ["2", "idle"], 60)
        return self

    def __exit__(self, *_):
        self.text("scancel", "--user=root")
        for program in reversed(self.programs):
            program.terminate()
            try:
                program.wait(20)
            except subprocess.TimeoutExpired:
                program.kill()
                program.wait()

    def text(self, *words, **options):
        return subprocess.run(words, env=self.environment, capture_output=True, text=True, **options).stdout

    def facts(self, job):
        """What Slurm says of a job's tasks, one after the other."""
        return [dict(re.findall(r"(\w+)=(\S+)", block)) for block in self.text("scontrol", "show", "job", job).split("\n\n")]


def begun_again(cluster, task):
    """Whether a task that was requeued runs again; Slurm would let it wait for two minutes."""
    facts = cluster.facts(task)[0]
    if facts["JobState"] == "PENDING":
        cluster.text("scontrol", "update", f"JobId={task}", "StartTime=now")
    return int(facts.get("Restarts", 0)) > 0 and facts["JobState"] in ("RUNNING", "COMPLETED")


def ended(cluster, job):
    """Waits for a job, which must succeed."""
    over = ("COMPLETED", "FAILED", "CANCELLED")
    wait_for(f"the end of job {job}", lambda: cluster.facts(job)[0].get("JobState") in over, 900)
    facts = cluster.facts(job)[0]
    check(f"job {job} succeeds", facts["JobState"] == "COMPLETED", str(facts))


def main():
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if os.geteuid() != 0 or missing:
        print(f"SKIPPED: a cluster of Slurm needs root, and {', '.join(missing) or 'all of its programs'}")
        return
    binary, folder = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    make(binary, folder, 40.0)
    (folder / "bin").mkdir()
    (folder / "bin/holosonar").symlink_to(binary)
    for name, text in scripts(folder).items():
        (folder / name).write_text(text)
    with Cluster(folder) as cluster:
        cluster.environment["PATH"] = f"{folder / 'bin'}:{Path(sys.executable).parent}:{os.environ['PATH']}"
        cluster.environment["XDG_STATE_HOME"] = str(folder / "state")
        submitted = subprocess.run(
            ["bash", "submit.sh"], cwd=folder, env=cluster.environment, capture_output=True, text=True
        )
        check("the guide's commands submit the jobs", submitted.returncode == 0, submitted.stderr)
        print(submitted.stdout, end="", flush=True)
        numbers = re.findall(r"\d+", submitted.stdout)
        (first, second, last) = (numbers[-2], numbers[-1], numbers[0])

        def running(job):
            tasks = [task for task in cluster.facts(job) if task.get("JobState") == "RUNNING"]
            numbers = [task["ArrayTaskId"] for task in tasks if task.get("ArrayTaskId", "").isdigit()]
            # One that was requeued came last, and found all of the simulation.
            other = [number for number in numbers if f"{first}_{number}" not in again]
            return f"{job}_{other[0]}" if other else None

        again = []
        # One of each array, of which the second reconstructs for seconds.
        for job in (first, second):
            task = wait_for(f"a running task of {job}", lambda: running(job), 300)
            time.sleep(0.5)
            requeued = subprocess.run(
                ["scontrol", "requeue", task], env=cluster.environment, capture_output=True, text=True
            )
            check(f"{task} is requeued", requeued.returncode == 0, requeued.stderr)
            again.append(task)
            wait_for(f"{task} begins again", lambda: begun_again(cluster, task), 240)
        ended(cluster, last)
        for job in (first, second):
            restarts = [int(task.get("Restarts", 0)) for task in cluster.facts(job)]
            check(f"one task of {job} ran twice", sum(restarts) == 1, str(restarts))
        dask = subprocess.run(
            ["sbatch", "--parsable", "dask.sh"], cwd=folder, env=cluster.environment, capture_output=True, text=True
        )
        check("the guide's job of Dask is submitted", dask.returncode == 0, dask.stderr)
        ended(cluster, dask.stdout.strip())
        workers = (folder / f"slurm-{dask.stdout.strip()}.out").read_text().count("Registered to:")
        check("Dask had two workers", workers == 2, str(workers))
    for name in ("out", "dask"):
        compare(folder, name)
    (job, number) = again[1].split("_")
    printed = (folder / f"slurm-{job}_{number}.out").read_text()
    print(f"{again[1]}, the second time: {printed}", end="")
    check("the second time had something left to do", not printed.startswith("computed 0 of"), printed)
    left = [name for name in os.listdir(folder / "out") if name.endswith((".unit", ".nodes", ".part", ".resume"))]
    check("nothing is left of the units", not left, str(left))
    conclude()


if __name__ == "__main__":
    main()
