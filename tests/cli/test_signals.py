"""SIGINT and SIGTERM at any moment: one line, the exit codes of shells, and no stack trace."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")

PROGRAM = """
import hashlib, sys, time
from diga3d_warp import cli
from diga3d_warp.cli import edits, signals
from diga3d_warp.process import load_pycolmap

def say_ready():
    print("ready", flush=True)

def between_lines():
    say_ready()
    while True:
        pass

def in_compiled_code():
    signals.GRACE = 0.5
    say_ready()
    hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)  # minutes, in C, beside other threads

def while_mapping():
    load_pycolmap()
    say_ready()
    time.sleep(60)

def in_a_finaliser():
    class Held:
        def __del__(self):
            say_ready()
            time.sleep(60)
    signals.GRACE = 0.5
    Held()
    time.sleep(60)

def turned_into_an_error():
    say_ready()
    try:
        time.sleep(60)
    except BaseException as error:
        raise RuntimeError("a library says something of its own") from error

def while_unwinding():
    try:
        say_ready()
        time.sleep(60)
    finally:
        say_ready()
        hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)

edits._fit = lambda **options: globals()[sys.argv[1]]()
sys.exit(cli.main(["fit", "my scene", "--out", "run"]))
"""


def attend_to_interrupts() -> None:
    """A test run in the background of a shell hands down that SIGINT is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def start(where: str, preexec_fn=attend_to_interrupts) -> subprocess.Popen:
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, where],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=preexec_fn,
    )  # fmt: skip
    assert process.stdout is not None and process.stdout.readline() == "ready\n", process.communicate()
    return process


PLACES = ["between_lines", "in_compiled_code", "while_mapping", "in_a_finaliser", "turned_into_an_error"]


@pytest.mark.parametrize("where", PLACES)
@pytest.mark.parametrize(("number", "word"), [(signal.SIGTERM, "terminated"), (signal.SIGINT, "interrupted")])
def test_a_signal_ends_the_program_in_one_line(where, number, word):
    process = start(where)
    process.send_signal(number)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    assert errors == f"\ndiga3d: {word}; go on with: diga3d fit 'my scene' --out run --resume\n"


def test_a_second_signal_ends_it_at_once():
    process = start("while_unwinding")
    process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=2.5)
    assert process.returncode == 130
    assert errors.count("\n") == 2 and "interrupted" in errors


def test_a_signal_that_was_ignored_stays_ignored():
    """A shell starts programs in the background so."""
    process = start("between_lines", preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN))
    process.send_signal(signal.SIGINT)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=0.3)
    process.terminate()
    assert process.wait(timeout=30) == 143


def test_output_that_nobody_reads_ends_it_quietly():
    words = "import sys; from diga3d_warp import cli; sys.exit(cli.main(['materials' if 0 else 'doctor']))"
    process = subprocess.Popen(
        [sys.executable, "-c", words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline()
    process.stdout.close()
    errors = process.stderr.read()
    assert process.wait(timeout=60) == 141
    assert "Traceback" not in errors and "BrokenPipe" not in errors
    process.stderr.close()
