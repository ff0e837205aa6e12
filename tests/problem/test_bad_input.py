"""Bad input: a clear error, on all ranks together."""

import subprocess
import sys

import bad_input
import pytest
import wrong_arguments
from conftest import clean_environment, run_mpi_json
from mpi4py import MPI
from sampling import longer


def test_input_errors_are_value_errors():
    assert issubclass(bad_input.INPUT, ValueError)
    assert issubclass(bad_input.INPUT, bad_input.llm.ContactError)
    assert issubclass(bad_input.llm.ContactError, RuntimeError)


def test_a_good_scene_is_accepted():
    """What the bad scenes are made from."""
    bad_input.blocks(MPI.COMM_SELF, solve=True)
    bad_input.blocks(MPI.COMM_SELF, frame=bad_input.llm.Frame(*bad_input.flat_frame(3)))


def test_a_failing_rank_ends_the_run():
    """The tests' own guard: an exception on one rank is no hang and no success."""
    with pytest.raises(pytest.fail.Exception, match="only on rank 1"):
        run_mpi_json("fails_on_rank_1.py", 2, seconds=30.0)


def test_a_hanging_run_is_ended():
    with pytest.raises(pytest.fail.Exception, match="took over 0.5"):
        run_mpi_json("hangs.py", 2, seconds=0.5)


def test_missing_dolfinx_is_said():
    """The import names the package and the way to get it."""
    code = "import sys; sys.modules['dolfinx'] = None; import dolfinx_llm"
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=clean_environment()
    )
    assert run.returncode == 1
    assert "ImportError: dolfinx_llm needs dolfinx" in run.stderr
    assert "apt install python3-dolfinx" in run.stderr


@pytest.mark.parametrize(("n", "part"), [longer(1, 0), (2, 0), longer(2, 1), longer(3, 0)])
def test_wrong_arguments(n, part):
    """Every public function refuses what it cannot use, and scenes that cannot be: in a sentence,
    the same on all ranks, else the others would hang; each on two ranks or on three."""
    found = run_mpi_json("wrong_arguments.py", n, part)
    expected = wrong_arguments.entries(n, part)
    assert list(found) == [name for name, *_ in expected]
    assert len(expected) > (400 if n == 1 else 300 if part else 40)
    wrong = {
        name: outcomes
        for name, outcomes in found.items()
        if len(outcomes) != n or not all(o == outcomes[0] and o[2] for o in outcomes)
    }
    assert wrong == {}


def test_products_beside_inner_products():
    """In real arithmetic v and conj(v) are one: a form may write both."""
    ufl = pytest.importorskip("ufl")
    from dolfinx import mesh as dmesh

    from dolfinx_llm.base import compat

    domain = dmesh.create_unit_square(MPI.COMM_SELF, 1, 1)
    V = compat.function_space(domain, shape=(2,))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    both = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + ufl.div(u) * ufl.div(v) * ufl.dx
    assert compat.form("a", both) is not None
