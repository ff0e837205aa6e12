"""Quiet by default, told by logging where it is asked for, progress on a terminal only."""

import os
import pty
import re
import subprocess
import sys
import termios

import pytest
from conftest import TESTS, clean_environment
from sampling import longer

TOLD = TESTS / "mpi" / "told.py"


def run(command):
    return subprocess.run(
        list(map(str, command)), env=clean_environment(), text=True, timeout=90, check=True,
        stdin=subprocess.DEVNULL, capture_output=True,
    )  # fmt: skip


def test_import_prints_nothing():
    done = run([sys.executable, "-c", "import dolfinx_llm, dolfinx_llm.plot"])
    assert done.stdout == "" and done.stderr == ""


def test_quiet_without_terminal():
    """Neither lines of the log nor progress where stderr is a file."""
    done = run([sys.executable, TOLD])
    if done.stderr:  # older dolfinx tells there of forms that it compiles
        done = run([sys.executable, TOLD])
    assert done.stdout.endswith("iterations\n") and done.stderr == ""


@pytest.mark.parametrize("n", [longer(1), 2])
def test_stages_and_iterations_are_told_by_rank_0(n):
    done = run(["mpirun", "-n", n, sys.executable, TOLD, "INFO"])
    lines = re.findall(r"^rank=(\d) (?:\[rank \d\] )?(.*)$", done.stderr, re.MULTILINE)
    assert {rank for rank, _ in lines} == {"0"}
    of_law = [text for _, text in lines if text.startswith("contact law, iteration")]
    assert f"{len(of_law)} iterations" in done.stdout
    assert re.search(r"iteration 1: \d+ in contact, \d+ stick, .* residual \d\.\de", of_law[0])
    for stage in ("interface", "assembly of K: ", "factorisation: ", "iteration of contact laws: "):
        assert any(text.startswith(stage) for _, text in lines), stage


def test_every_rank_tells_at_level_debug():
    done = run(["mpirun", "-n", 2, sys.executable, TOLD, "DEBUG"])
    for rank in "01":
        assert f"rank={rank} [rank {rank}] built" in done.stderr
    assert "rank=1 [rank 1] contact law" not in done.stderr


@pytest.mark.parametrize("level", ["WARNING", longer("INFO")])
def test_progress_on_a_terminal(level):
    """One line that is rewritten; none where the log tells of the iterations already."""
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (24, 100))  # tqdm 4.70 shows nothing on one without lines
    process = subprocess.Popen(
        [sys.executable, str(TOLD), level], env=clean_environment(), text=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=theirs,
    )  # fmt: skip
    os.close(theirs)
    seen = b""
    try:
        while part := os.read(ours, 65536):
            seen += part
    except OSError:  # so a terminal ends on Linux
        pass
    os.close(ours)
    assert process.communicate(timeout=90)[0].endswith("iterations\n")
    assert (b"iteration of contact laws: 0it" in seen) == (level == "WARNING")
    assert (b"contact law, iteration 1" in seen) == (level == "INFO")
