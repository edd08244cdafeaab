"""Poses, the graph of named frames, alignment of points, and the camera model."""
