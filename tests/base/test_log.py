"""Quiet by default, told by logging where it is asked for, progress on a terminal only."""

import os
import pty
import re
import subprocess
import sys
import termios

import pytest
from conftest import TESTS, clean_environment, run_mpi
from sampling import longer

TOLD = TESTS / "mpi" / "told.py"


def test_quiet_without_terminal():
    """Neither imports nor solves print where stderr is a file: no log, no progress."""
    for again in (False, True):
        done = subprocess.run(
            [sys.executable, str(TOLD)], env=clean_environment(), text=True, timeout=90, check=True,
            stdin=subprocess.DEVNULL, capture_output=True,
        )  # fmt: skip
        if again or not done.stderr:  # older dolfinx tells there of forms that it compiles
            break
    assert re.fullmatch(r"\s*\d+ iterations\n", done.stdout)
    assert done.stderr == ""


@pytest.mark.parametrize("n", [longer(1), 2])
def test_stages_and_iterations_are_told_by_rank_0(n):
    """And by all ranks what is of level DEBUG."""
    out = run_mpi("told.py", n, "DEBUG", "gathered")
    lines = re.findall(r"^(\w+) rank=(\d) (\[rank \d\] )?(.*)$", out, re.MULTILINE)
    assert {rank for level, rank, _, _ in lines if level == "INFO"} == {"0"}
    built = [
        (rank, name) for level, rank, name, text in lines if (level, text) == ("DEBUG", "built")
    ]
    assert built == [(str(k), f"[rank {k}] " if n > 1 else "") for k in range(n)]
    of_law = [text for *_, text in lines if text.startswith("contact law, iteration")]
    assert f"{len(of_law)} iterations" in out
    assert re.search(r"iteration 1: \d+ in contact, \d+ stick, .* residual \d\.\de", of_law[0])
    for stage in ("interface", "assembly of K: ", "factorisation: ", "iteration of contact laws: "):
        assert any(text.startswith(stage) for *_, text in lines), stage


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
