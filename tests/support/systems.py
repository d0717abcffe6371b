"""Marks of tests that need more than every system has."""

import os

import pytest

posix = pytest.mark.skipif(os.name == "nt", reason="needs signals, symbolic links, forks or a shell of POSIX")
