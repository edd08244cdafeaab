"""Height maps of terrain models: made from a crater law, or read from a file."""
