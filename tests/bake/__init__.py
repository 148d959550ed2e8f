"""Tests of what makes a plain asset of a model."""
