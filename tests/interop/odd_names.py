"""Publishes text on DDS topics whose names ROS does not allow, with Eclipse Cyclone DDS, and on one that it allows.

usage: odd_names.py TOPIC ...

Each TOPIC is a name in DDS (rt/a-b). Publishes at 10 Hz until it is ended.
"""

import os
import sys
import time
from dataclasses import dataclass

# Read when the library is loaded. Loopback without multicast: participants are discovered by port.
os.environ["CYCLONEDDS_URI"] = """<CycloneDDS><Domain>
  <General><Interfaces><NetworkInterface name="lo"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
  <Discovery>
    <ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
    <Peers><Peer address="127.0.0.1"/></Peers>
  </Discovery>
</Domain></CycloneDDS>"""

from cyclonedds.core import Policy, Qos  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import IdlStruct  # noqa: E402
from cyclonedds.pub import DataWriter  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402


@dataclass
class Text(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
qos = Qos(Policy.Reliability.BestEffort, Policy.DataRepresentation(use_cdrv0_representation=True))
writers = [DataWriter(participant, Topic(participant, name, Text), qos=qos) for name in sys.argv[1:]]
while True:
    for writer in writers:
        writer.write(Text("x"))
    time.sleep(0.1)
