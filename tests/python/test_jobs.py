"""Jobs: the interpreter goes on meanwhile; progress, warnings, and Ctrl-C."""

import signal
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest

import holosonar


@pytest.fixture
def long_job():
    """Some 10^11 literal terms: minutes."""
    instrument = holosonar.Instrument(
        holosonar.stepped_frequencies(10e3, 20e3, 20.0), holosonar.rectangular_array((41, 41), 0.02)
    )
    cube = holosonar.Cube(np.ones(instrument.shape, np.complex64), instrument)
    grid = holosonar.Grid.spanning(x=(-0.4, 0.4), y=(-0.4, 0.4), z=(1, 1.5), pitch=0.01)

    def run(**options):
        return holosonar.reconstruct(cube, grid, method="direct", **options)

    return run


def test_progress_is_reported_on_the_callers_thread(instrument, reflectors, grid):
    seen = []

    def report(stage, done, total):
        assert threading.current_thread() is threading.main_thread()
        seen.append((stage, done, total))

    cube = holosonar.simulate(reflectors, instrument, progress=report)
    assert seen[0] == ("simulating", 0, 63) and seen[-1][1] == seen[-1][2] > 0
    holosonar.reconstruct(cube, grid, progress=report)
    assert ("reconstructing" in {stage for stage, _, _ in seen}) and seen[-1][1] == seen[-1][2]
    assert all(0 <= done <= total or total == 0 for _, done, total in seen)


def test_bars_of_tqdm(instrument, reflectors):
    tqdm = pytest.importorskip("tqdm")
    bars = []

    class Bar(tqdm.tqdm):
        def __init__(self, **options):
            super().__init__(**options, file=open("/dev/null", "w"))
            bars.append(self)

    holosonar.simulate(reflectors, instrument, progress=Bar)
    assert [bar.desc.rstrip(": ") for bar in bars] == ["simulating"]
    assert bars[0].n == bars[0].total == 63
    for bar in bars:
        bar.fp.close()


def test_what_a_callback_raises_stops_the_job_and_is_passed_on(long_job):
    class Enough(Exception):
        pass

    def report(stage, done, total):
        if stage.startswith("reconstructing") and done > 0:
            raise Enough

    begun = time.monotonic()
    with pytest.raises(Enough):
        long_job(progress=report)
    assert time.monotonic() - begun < 20


def test_the_interpreter_goes_on_meanwhile(long_job):
    counted, failed = 0, []
    stop = threading.Event()

    def report(stage, done, total):
        if stop.is_set():
            raise InterruptedError

    def work():
        try:
            long_job(progress=report)
        except InterruptedError as error:
            failed.append(error)

    job = threading.Thread(target=work)
    job.start()
    until = time.monotonic() + 1.0
    while time.monotonic() < until:
        counted += 1
        time.sleep(0.001)
    stop.set()
    job.join(30)
    assert not job.is_alive() and failed
    assert counted > 100, "the job held the interpreter"


def test_control_c_stops_a_job_within_a_fifth_of_a_second():
    program = """
        import signal, threading, time
        import numpy as np
        import holosonar

        instrument = holosonar.Instrument(
            holosonar.stepped_frequencies(10e3, 20e3, 20.0), holosonar.rectangular_array((41, 41), 0.02)
        )
        cube = holosonar.Cube(np.ones(instrument.shape, np.complex64), instrument)
        grid = holosonar.Grid.spanning(x=(-0.4, 0.4), y=(-0.4, 0.4), z=(1, 1.5), pitch=0.01)
        sent = []

        def interrupt():
            sent.append(time.monotonic())
            signal.raise_signal(signal.SIGINT)

        # A shell has commands in the background ignore it.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        threading.Timer(1.0, interrupt).start()
        try:
            holosonar.reconstruct(cube, grid, method="direct")
        except KeyboardInterrupt:
            print(time.monotonic() - sent[0])
        assert abs(holosonar.reconstruct(cube, grid).samples).max() > 0, "the next job runs"
    """
    ran = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert float(ran.stdout) < LATENCY, ran.stdout


#: Where other work takes the processor the threads wait for it, too.
LATENCY = 1.0


def test_warnings_name_the_callers_line(instrument, reflectors):
    wide = holosonar.Grid.spanning(x=(-1, 1), y=(-1, 1), z=(0.7, 0.8), pitch=0.1)
    cube = holosonar.simulate(reflectors, instrument)
    with pytest.warns(holosonar.HolosonarWarning, match="grating lobes") as said:
        holosonar.reconstruct(cube, wide)
    assert said[0].filename == __file__
    # As an error it ends the job.
    with pytest.raises(holosonar.HolosonarWarning, match="grating lobes"):
        holosonar.reconstruct(cube, wide)


def test_the_command_hears_control_c(tmp_path, corner):
    job = ["image", str(corner), "-o", str(tmp_path / "out"), "--set", "reconstruct.method=direct"]
    process = subprocess.Popen([sys.executable, "-m", "holosonar", *job], stderr=subprocess.PIPE, text=True)
    time.sleep(1.5)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    if process.returncode != 0:  # it may have been done
        assert process.returncode == 130, said
        assert "Traceback" not in said and "interrupted" in said
