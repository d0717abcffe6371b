"""Tests that compile the small FMUs of tests/support/small_fmus."""

import pytest

from tests.support.small_fmus import COMPILER

needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler found")
