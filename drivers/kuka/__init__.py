"""KUKA KR 16 on a rail: driver over EthernetKRL or KUKAVARPROXY, kinematics, simulators, KRL."""
