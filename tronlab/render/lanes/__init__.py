"""Rays followed together, lane by lane: what makes the fast renderer fast."""
