"""Failures of the shared tests are explained like those of the others."""

import pytest

pytest.register_assert_rewrite("tests.papers.reproduction")
