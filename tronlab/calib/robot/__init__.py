"""Where robot and rail stand, so that poses can be driven to."""
