"""A small job for several processes, for the programs of this folder that share one."""

import subprocess
import time

from checks import check, conclude

RUN = """
[scene]
mesh = "points.csv"
[sweep]
start = 10e3
stop = 20e3
step = {step}
[array]
count = [24, 24]
pitch = [0.024, 0.024]
[grid]
x = [-0.5, 0.5]
y = [-0.5, 0.5]
z = [1.4, 2.2]
pitch = [0.01, 0.01, 0.01]
[reconstruct]
method = "direct"
[output]
formats = ["npz"]
report = false
points = false
"""


def make(binary, folder, step, environment=None):
    """Makes the folder with ``run.toml``, which takes seconds, and images it by one process into ``whole``."""
    folder.mkdir()
    points = "".join(f"{0.04 * i - 0.4},{0.3 - 0.03 * i},{1.5 + 0.03 * i},1\n" for i in range(20))
    (folder / "points.csv").write_text(f"x,y,z,amplitude\n{points}")
    (folder / "run.toml").write_text(RUN.format(step=step))
    subprocess.run([binary, "-q", "image", folder / "run.toml", "-o", folder / "whole"], check=True, env=environment)


def compare(folder, name):
    """Checks that an image has the bytes of one process."""
    image = folder / name / "volume.npz"
    same = image.exists() and image.read_bytes() == (folder / "whole/volume.npz").read_bytes()
    check(f"{name}: the bytes are those of one process", same)


def wait_for(what, holds, seconds):
    """Waits until something holds, and gives it; where it takes longer, nothing that follows could be checked."""
    deadline = time.monotonic() + seconds
    while not (found := holds()):
        if time.monotonic() > deadline:
            check(f"{what} within {seconds} s", False)
            conclude()
        time.sleep(0.02)
    return found
