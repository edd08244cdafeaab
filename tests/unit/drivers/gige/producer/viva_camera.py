"""Run viva-genicam's fake GigE Vision camera until standard input ends: ADDRESS PORT DROPPED.

A line "revoke" takes the control privilege away; any other line changes nothing. Each is answered
with a line of JSON.
"""

import json
import sys

from viva_genicam.testing import FakeGigeCamera

address, port, dropped = sys.argv[1], int(sys.argv[2]), json.loads(sys.argv[3])
with FakeGigeCamera(
    width=640,
    height=480,
    fps=60,
    bind_ip=address,
    port=port,
    pixel_format="Mono12",
    drop_packets=[(block, packet) for block, packet in dropped],
) as camera:
    print(json.dumps({"ready": True}), flush=True)
    for line in sys.stdin:
        if line.strip() == "revoke":
            camera.revoke_control()
        answer = {"controller": camera.controller(), "sent": camera.blocks_sent()}
        print(json.dumps(answer), flush=True)
