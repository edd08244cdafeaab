"""Run a command beside a camera that knows no port but the standard's.

``unshare -n python own_network.py CAMERA COMMAND...`` gives both a network of their own, in which
``cam0`` is a network interface at 10.9.0.1/24. CAMERA is a command as a list in JSON.
"""

import json
import subprocess
import sys
import time

INTERFACE = (
    "link set lo up",
    "link add cam0 type veth peer name cam1",
    "address add 10.9.0.1/24 dev cam0",
    "link set cam0 up",
    "link set cam1 up",
)

for step in INTERFACE:
    subprocess.run(["ip", *step.split()], check=True)
with subprocess.Popen(
    json.loads(sys.argv[1]), stdin=subprocess.PIPE, stdout=subprocess.DEVNULL
) as camera:
    time.sleep(1.0)  # neither camera tells when it listens
    try:
        if camera.poll() is not None:
            sys.exit("the camera ended at once")
        sys.exit(subprocess.run(sys.argv[2:], check=False).returncode)
    finally:
        camera.kill()
