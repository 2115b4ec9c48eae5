"""A prior in the plane, tied to its start, which the adaptations are tried on."""

import pytest
from plane_prior import plane_prior


@pytest.fixture(scope="module")
def prior():
    return plane_prior()
