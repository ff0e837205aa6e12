"""Paths for the tests' own modules, and MPI runs in processes of their own."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent
PATHS = [str(TESTS), str(TESTS / "mpi"), str(TESTS.parent / "demos")]
sys.path[:0] = PATHS

# Of the launchers' variables only settings that a user made are kept: what a process that has
# called MPI_Init inherits makes a second mpirun fail without a word.
LAUNCHERS = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDRA_", "MPI_LOCAL")
SETTINGS = ("OMPI_MCA_", "OMPI_ALLOW_", "PRTE_MCA_", "PMIX_MCA_")


def clean_environment() -> dict[str, str]:
    """Environment for a spawned mpirun."""
    env = {
        key: value
        for key, value in os.environ.items()
        if not key.startswith(LAUNCHERS) or key.startswith(SETTINGS)
    }
    return {
        **env,
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        # More ranks than cores, in Open MPI 4, 5 and 6.
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
        "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
        "PRTE_MCA_mapby": ":oversubscribe",
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join([*PATHS, os.environ.get("PYTHONPATH", "")]).strip(os.pathsep),
    }


def run_mpi(script: str, n: int, *args, seconds: float = 90.0) -> str:
    """Run tests/mpi/<script> on n ranks and return what it printed.

    An exception on any rank ends all of them, so that none waits for it; after ``seconds`` the
    run is ended. Both fail the test with the ranks' output.
    """
    command = ["mpirun", "-n", str(n), sys.executable, str(TESTS / "mpi" / "guard.py")]
    command += [str(TESTS / "mpi" / script), *map(str, args)]
    process = subprocess.Popen(
        command,
        env=clean_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        out, err = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.terminate()  # mpirun ends its ranks
        try:
            out, err = process.communicate(timeout=10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            out, err = process.communicate()
        pytest.fail(f"{' '.join(command)}\ntook over {seconds} s\n{out[-4000:]}\n{err[-4000:]}")
    if process.returncode != 0:
        pytest.fail(
            f"{' '.join(command)}\nended with {process.returncode}\n{out[-4000:]}\n{err[-4000:]}"
        )
    return out


def run_mpi_json(script: str, n: int, *args, seconds: float = 90.0):
    """The same, for scripts whose rank 0 prints one line of JSON; PETSc may add others."""
    out = run_mpi(script, n, *args, seconds=seconds)
    lines = [line for line in out.splitlines() if line.startswith("{")]
    assert len(lines) == 1, f"{script} printed no line of JSON, or several: {out[-2000:]}"
    return json.loads(lines[0])
