"""From the axes of a robot to its flange, and back."""
