"""Drivers of real laboratory devices: one folder a device, found through entry points."""
