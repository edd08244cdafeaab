"""Asking cores for the poses of shots: units, workers, a cluster, and what is kept."""
