"""Random walls by K u - f and positions; 6: forces at joints were out of balance by 2 %."""

import pytest
import wall_campaign


@pytest.mark.long
@pytest.mark.parametrize("seed", range(1, 9))
def test_random_walls(seed):
    """What stands is right; of what falls both forms say so."""
    assert wall_campaign.verdict(seed) == ("right: falls" if seed in (4, 7, 8) else "right")
