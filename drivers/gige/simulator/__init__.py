"""A GigE Vision camera on the wire: a Prosilica GC1380H by its feature names.

``python -m drivers.gige.simulator`` runs one alone, over a test pattern; with ``--rig`` it shows
what the camera of the simulated laboratory sees.
"""

from drivers.gige.simulator.faults import FAULTS

__all__ = ["FAULTS"]
