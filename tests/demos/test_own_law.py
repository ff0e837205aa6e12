"""Laws of one's own against closed forms: in 2D and 3D, all forms, one and two ranks."""

import numpy as np
import own_law
import pytest
from conftest import run_mpi_json

from dolfinx_llm.forms import choice

SCENES = {
    "glue": (own_law.Glue(), 0.0),
    "inclined": (own_law.Glue(), 30.0),
    "soft": (own_law.Soft(), 0.0),
}


def assert_known(rows):
    largest = max(abs(row["closed form"]) for row in rows)
    assert largest > 1.0
    for row in rows:
        assert abs(row["stress"] - row["closed form"]) <= 1e-11 * largest
        assert row["uneven"] <= 1e-10 * largest
        assert row["iterations"] <= 6


FORMS = ("flexibility", "saddle", "condensed")
CASES = [(scene, 2, form) for scene in SCENES for form in FORMS]
CASES += [("inclined", 3, form) for form in FORMS]
CASES += [("soft", 3, "condensed"), ("glue", 3, "flexibility")]


@pytest.mark.parametrize("scene, dim, form", CASES)
def test_closed_form(scene, dim, form, monkeypatch):
    law, angle = SCENES[scene]
    monkeypatch.setattr(choice, "FLEXIBLE", 10**6 if form == "flexibility" else 0)
    solver = "saddle" if form == "flexibility" else form
    found, rows = own_law.run(law, dim, (4, 6) if dim == 2 else (3, 2), angle, solver)
    assert found == form
    assert_known(rows)


def test_on_ranks():
    for rows in run_mpi_json("../../demos/own_law.py", 2, "--json").values():
        assert_known(rows)


def test_closed_form_by_hand():
    """The glue's branches at hand values: compliance 2 (1 - ν²) / E = 0.00182 in 2D."""
    law, compliance = own_law.Glue(), 2.0 * (1 - 0.09) / 1000.0
    stress, _ = own_law.stress_of(law, 0.004, 2, 0.0)
    assert stress == pytest.approx(0.004 / (compliance + 1 / 4000.0))
    # Falling from 4 at 0.001 to 0 at 0.0145: s = 4 (0.0145 - Δ) / 0.0135, U = s C + Δ.
    slope = 4.0 / 0.0135
    opening = (0.011 - slope * compliance * 0.0145) / (1.0 - slope * compliance)
    stress, largest = own_law.stress_of(law, 0.011, 2, 0.0)
    assert largest == pytest.approx(opening) and stress == pytest.approx(slope * (0.0145 - opening))
    again, _ = own_law.stress_of(law, 0.005, 2, 0.0, largest)
    assert again == pytest.approx(stress * 0.005 / 0.011)
    assert np.isclose(own_law.stress_of(law, 0.02, 2, 0.0)[0], 0.0, atol=1e-12)
