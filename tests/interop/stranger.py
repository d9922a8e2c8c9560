"""A stranger on the network: an Eclipse Cyclone DDS participant that discovers the node at ADDRESS and sends to it.

usage: stranger.py OWN_ADDRESS ADDRESS SECONDS

Publishes `std_msgs/msg/String` on /wm/told ten times a second. Prints one line of JSON: how many participants beside
itself it has found, and whether a subscription was connected to it. Ends early when it has found one.
"""

import json
import os
import sys
import time
from dataclasses import dataclass

OWN, PEER, SECONDS = sys.argv[1], sys.argv[2], float(sys.argv[3])
# Read when the library is loaded.
os.environ["CYCLONEDDS_URI"] = f"""<CycloneDDS><Domain>
  <General><Interfaces><NetworkInterface address="{OWN}"/></Interfaces><AllowMulticast>true</AllowMulticast></General>
  <Discovery>
    <ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
    <Peers><Peer address="{PEER}"/></Peers>
  </Discovery>
</Domain></CycloneDDS>"""

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsParticipant  # noqa: E402
from cyclonedds.core import Policy, Qos  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import IdlStruct  # noqa: E402
from cyclonedds.pub import DataWriter  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402
from cyclonedds.util import duration  # noqa: E402


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
found = BuiltinDataReader(participant, BuiltinTopicDcpsParticipant)
qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)))
writer = DataWriter(participant, Topic(participant, "rt/wm/told", String, qos=qos), qos=qos)
others, connected, end = set(), False, time.monotonic() + SECONDS
while time.monotonic() < end and not connected:
    others |= {str(sample.key) for sample in found.take(N=32)} - {str(participant.guid)}
    connected = len(writer.get_matched_subscriptions()) > 0
    writer.write(String("from a stranger"))
    time.sleep(0.1)
# time for the messages to arrive
for _ in range(10 if connected else 0):
    writer.write(String("from a stranger"))
    time.sleep(0.1)
print(json.dumps({"others": len(others), "connected": connected}), flush=True)
