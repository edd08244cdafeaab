"""A simulated Leica AT901-MR with a T-MAC that speaks the emScon TPI.

``python -m drivers.leica.simulator`` runs one. Its tables of bytes are written from the protocol,
independently of the driver's, so that a mistake shared by both cannot hide.

No document says the following, so a real tracker may do otherwise:

- StartMeasurement is answered 10004 without a target, 23 and 75 with one of the wrong kind; a
  search that finds nothing is answered 701. A refusal has 16 bytes.
- PointLaser catches a target within the search radius unless parameter 3 (beam capture) is 0.
- A 6-D measurement whose rotation is invalid ends with an error packet (49, 93), or with a result
  that says so if parameter 2 asks for all.
- While the tracker moves or measures it answers questions, StopMeasurement and ClearCommandQueue,
  and everything else with 1 (busy).
- A second client is told 10011 in an error packet and closed. Settings outlive a connection.
- Time stamps of samples are those of a steady clock whose zero is anywhere.
- What ``presentation`` and ``targets`` say of angles, transformations, ids and distance constants.

Not simulated, and answered 2 (not implemented): commands of the cameras, MoveHV, regions of
continuous measurements, and what only other trackers have.
"""

from drivers.leica.simulator.faults import FAULTS

__all__ = ["FAULTS"]
