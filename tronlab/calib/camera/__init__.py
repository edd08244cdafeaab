"""The camera and the board it is calibrated with."""
