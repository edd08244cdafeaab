"""Leica laser trackers with emScon controllers (AT901 and kin), with T-MAC, over TCP."""
