"""What the command line tells whoever started it; 0 is success."""

USER_ERROR = 2
INTERRUPTED = 130
