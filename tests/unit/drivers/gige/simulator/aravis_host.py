"""Run the camera test of Debian's aravis against a simulated camera that loses packets.

``python aravis_host.py PROGRAM [--own-network]``; with the latter, in a network namespace whose
loopback is not up yet. Prints what the program prints.
"""

import subprocess
import sys

from own_network import raise_loopback

SIMULATOR = [sys.executable, "-m", "drivers.gige.simulator", "--fault", "camera.lose_packets"]
OPTIONS = ["-n", "127.0.0.1", "-a", "-j", "always", "-f", "20", "-e", "1000", "--duration", "3"]


def main() -> int:
    """Give the exit code of the program."""
    if "--own-network" in sys.argv:
        raise_loopback()
    with subprocess.Popen(SIMULATOR, stdout=subprocess.PIPE, text=True) as simulator:
        try:
            simulator.stdout.readline()
            return subprocess.run([sys.argv[1], *OPTIONS], check=False).returncode
        finally:
            simulator.terminate()


if __name__ == "__main__":
    raise SystemExit(main())
