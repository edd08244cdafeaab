"""Errors of a navigation core against a dataset's ground truth."""
