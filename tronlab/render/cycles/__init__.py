"""Blender's path tracer, in a process of its own."""
