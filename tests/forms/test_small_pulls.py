"""What springs carry while contact is being found: much ends a load step, little another form may
tell better."""

from types import SimpleNamespace

import numpy as np
import pytest

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.forms.floating import Pull
from dolfinx_llm.forms.verdict import FinalError

pytestmark = pytest.mark.quick


@pytest.mark.parametrize(("share", "final"), [(1e-6, False), (1e-2, True)])
def test_what_is_left_of_a_load(share, final):
    """A band on a drum, both ends of which are pulled alike: all but some nodes slip, and with all
    of them slipping 1e-8 to 1e-6 of the forces is left; it was told to be pulled off for good."""
    rigid = SimpleNamespace(describe=lambda *told: "body 0")
    floating = SimpleNamespace(
        count=1, square=np.eye(1), grip=np.zeros((0, 1)), sizes=lambda f: np.ones(1), rigid=rigid
    )
    pull = Pull(floating, 1.0, np.zeros(0), 0.0, np.zeros(1))
    with pytest.raises(ContactError, match=f"{share:.1e} of the forces is left") as raised:
        for _ in range(20):
            pull.watch(pull.anchor + share, np.zeros(0), 2, 0.0)
    assert isinstance(raised.value, FinalError) == final
