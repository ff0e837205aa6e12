"""Paths for the tests' own modules, and MPI runs in processes of their own."""

import contextlib
import fcntl
import io
import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent
PATHS = [str(p) for p in (TESTS, TESTS / "shared", TESTS / "mpi", TESTS.parent / "demos")]
sys.path[:0] = PATHS

# Of the launchers' variables only settings that a user made are kept: what a process that has
# called MPI_Init inherits makes a second mpirun fail without a word.
LAUNCHERS = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDRA_", "MPI_LOCAL")
SETTINGS = ("OMPI_MCA_", "OMPI_ALLOW_", "PRTE_MCA_", "PMIX_MCA_")

# Workers wait for a form that another one compiles; 10 s, as dolfinx has it, may be too few. On a
# new machine compilation takes a fifth of the time: less without optimisation.
JIT = {"timeout": 300, "cffi_extra_compile_args": ["-O0", "-g0"]}
if "PYTEST_XDIST_WORKER" in os.environ:
    _settings = tempfile.TemporaryDirectory()
    os.environ["XDG_CONFIG_HOME"] = _settings.name
    (Path(_settings.name) / "dolfinx").mkdir()
    for _name in ("dolfinx_jit_options.json", "dolfinx_jit_parameters.json"):
        (Path(_settings.name) / "dolfinx" / _name).write_text(json.dumps(JIT))

LIMIT = 600.0  # seconds: it catches ranks that hang, also on a machine with much other work
DONE = "== done: "  # with what follows, the line that ends a script's output


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
        # More ranks than cores, in Open MPI 4, 5 and 6; those that wait leave the core to others.
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
        "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
        "PRTE_MCA_mapby": ":oversubscribe",
        "OMPI_MCA_mpi_yield_when_idle": "1",
        "OMP_NUM_THREADS": "1",
        "SCOTCH_PTHREAD_NUMBER": "1",  # with more, PT-Scotch 7.0 has hung on 4 ranks
        "PYTHONPATH": os.pathsep.join([*PATHS, os.environ.get("PYTHONPATH", "")]).strip(os.pathsep),
    }


# Every other rank has the kernels of an older processor, which round otherwise: as on machines of
# several kinds, and on one where LAPACK's results depend on where arrays lie. No rank may choose by
# that for itself.
UNLIKE = """
if [ $((${OMPI_COMM_WORLD_RANK:-${PMI_RANK:-0}} % 2)) = 1 ]; then
    export OPENBLAS_CORETYPE=Nehalem NPY_DISABLE_CPU_FEATURES=AVX512F
fi
exec "$@"
"""


class Ranks:
    """An mpirun of n ranks that runs one script after the other, see mpi/guard.py."""

    def __init__(self, n: int):
        self.errors, guard = tempfile.TemporaryFile("w+"), [str(TESTS / "mpi" / "guard.py")]
        self.process = subprocess.Popen(
            ["mpirun", "-n", str(n), "sh", "-c", UNLIKE, "sh", sys.executable, *guard],
            env=clean_environment(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            text=True,
        )
        self.lines: queue.Queue[str | None] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self.lines.put(line)
        self.lines.put(None)

    def run(self, command: list[str], seconds: float) -> str | None:
        """What a script printed; None where it has not ended as it should, and all have ended."""
        end, self.out = time.monotonic() + seconds, ""
        mark = DONE + str(time.monotonic_ns())
        try:
            self.process.stdin.write(json.dumps([mark, *command]) + "\n")
            self.process.stdin.flush()
            while (line := self.lines.get(timeout=max(end - time.monotonic(), 0.01))) is not None:
                if line.rstrip("\n") == mark:
                    return self.out
                self.out += line
        except (queue.Empty, BrokenPipeError):
            pass
        self.stop(terminate=time.monotonic() > end)
        return None

    def stop(self, terminate: bool = False) -> None:
        """End the ranks; mpirun ends those that hang."""
        if terminate:
            self.process.terminate()
        try:
            self.process.stdin.close()
        except BrokenPipeError:
            pass
        try:
            self.process.wait(timeout=60.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def complaints(self) -> str:
        """The end of what the ranks wrote to stderr."""
        self.errors.seek(0)
        return self.errors.read()[-4000:]


@pytest.hookimpl(tryfirst=True)  # before xdist looks for its groups
def pytest_collection_modifyitems(config, items):
    """Mark the tests that run on ranks of their own: by the names that they use.

    Of several workers one runs these, one after the other and before all else. With PART=K/N in the
    environment every N-th test is run, from the K-th on: of those marked long where ``-m long``
    asks for these, else of the others.
    """
    if part := os.environ.get("PART"):
        k, n = map(int, part.split("/"))
        asked = config.option.markexpr == "long"
        some = [item for item in items if bool(item.get_closest_marker("long")) == asked]
        items[:] = some[k % n :: n]
    for item in items:
        params = getattr(item, "callspec", None) and item.callspec.params or {}
        code = getattr(getattr(item, "function", None), "__code__", None)
        ranks = {"run_mpi", "run_mpi_json", "mpirun"} & words_of(code)
        ranks = ranks and params.get("n", params.get("ranks")) != 1  # that is this process
        if ranks:
            item.add_marker(pytest.mark.mpi)
        item.add_marker(pytest.mark.xdist_group("mpi" if ranks else item.path.name))
    if "PYTEST_XDIST_WORKER" in os.environ:  # large files first, so that workers end together
        tests = Counter(item.path for item in items)
        items.sort(key=lambda i: (i.get_closest_marker("mpi") is None, -tests[i.path]))


# Tests share the first one's lock; those on ranks of their own want it alone. Who waits for it
# holds the second one's, so that nobody else gets in between.
LOCKS = open(__file__), open(TESTS / "mpi" / "guard.py")
_alone = False


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item, nextitem):
    """Beside another worker ranks take many times as long: where one waits, it yields its core."""
    global _alone
    ranks = [i is not None and i.get_closest_marker("mpi") is not None for i in (item, nextitem)]
    if not _alone:
        for lock in LOCKS[::-1]:
            fcntl.flock(lock, fcntl.LOCK_EX if ranks[0] else fcntl.LOCK_SH)
        fcntl.flock(LOCKS[1], fcntl.LOCK_UN)
    yield
    _alone = all(ranks)
    if not _alone:
        fcntl.flock(LOCKS[0], fcntl.LOCK_UN)


@pytest.fixture(autouse=True)
def _choice_of_form():
    """Scenes that ask for a form set the size up to which it is chosen."""
    from dolfinx_llm.forms import choice

    before = choice.FLEXIBLE
    yield
    choice.FLEXIBLE = before


def words_of(code) -> set[str]:
    """Names and strings in a function and in those inside of it."""
    found: set[str] = set()
    for word in (*code.co_names, *code.co_consts) if code else ():
        found |= {word} if isinstance(word, str) else set()
        found |= words_of(word) if hasattr(word, "co_names") else set()
    return found


_running: dict[int, Ranks] = {}


@pytest.fixture(scope="session", autouse=True)
def _one_mpirun_per_number_of_ranks():
    """They are started when first asked for and end with the tests."""
    yield
    for n in list(_running):
        _running.pop(n).stop()


def run_mpi(script: str, n: int, *args, seconds: float = LIMIT) -> str:
    """Run tests/mpi/<script> on n ranks and return what it printed.

    All scripts run one after the other on the same ranks. An exception on any rank ends all of
    them, so that none waits for it; after ``seconds`` they are ended. Both fail the test with the
    ranks' output. One rank is this process.
    """
    command = [str(TESTS / "mpi" / script), *map(str, args)]
    if n == 1:
        import guard

        with contextlib.redirect_stdout(io.StringIO()) as printed:
            guard.run(command)
        return printed.getvalue()
    if n not in _running:
        _running[n] = Ranks(n)
    ranks, began = _running[n], time.monotonic()
    out = ranks.run(command, seconds)
    if out is None:
        del _running[n]
        why = f"ended with {ranks.process.returncode}"
        if time.monotonic() - began >= seconds:
            why = f"took over {seconds} s"
        text = f"{ranks.out[-4000:]}\n{ranks.complaints()}"
        pytest.fail(f"{' '.join(command)} on {n} rank(s)\n{why}\n{text}")
    return out


def run_mpi_json(script: str, n: int, *args, seconds: float = LIMIT):
    """The same, for scripts whose rank 0 prints one line of JSON; PETSc may add others."""
    out = run_mpi(script, n, *args, seconds=seconds)
    lines = [line for line in out.splitlines() if line.startswith("{")]
    assert len(lines) == 1, f"{script} printed no line of JSON, or several: {out[-2000:]}"
    return json.loads(lines[0])
