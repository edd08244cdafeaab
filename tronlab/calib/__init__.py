"""Calibration: the model frame, camera intrinsics and hand-eye, kept in a record."""
