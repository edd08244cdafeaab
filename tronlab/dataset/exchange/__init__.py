"""Datasets of others read in, and ours written out, in the formats that are in use."""
