"""The recorded dataset: its layout, writing it shot by shot, reading and validating it."""
