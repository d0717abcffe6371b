"""What the tests of a link share: recorded flights that are told as states."""

from __future__ import annotations

import pytest

from tests.support.live_states import Flown


@pytest.fixture(scope="session")
def flown() -> Flown:
    """Two practice records, of a plug with five thermocouples and of an elevon."""
    return Flown.of()
