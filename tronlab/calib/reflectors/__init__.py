"""What reflectors tell: the model frame, the lamp, and whether the tracker has moved."""
