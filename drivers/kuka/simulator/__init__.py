"""A simulated KUKA controller on the wire: EthernetKRL and KUKAVARPROXY over one robot."""

from drivers.kuka.simulator.faults import FAULTS

__all__ = ["FAULTS"]
