"""What the command line tells whoever started it; 0 is success."""

REGRESSION = 1
"""What was compared is worse than its base."""
USER_ERROR = 2
INTERRUPTED = 130
