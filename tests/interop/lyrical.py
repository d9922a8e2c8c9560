"""A camera as ROS 2 Lyrical's `rmw_fastrtps_cpp` announces it, with Eclipse Cyclone DDS.

usage: lyrical.py TOPIC HASH [forgetful]

Publishes `sensor_msgs/msg/Image` on TOPIC at 10 Hz until it is ended. The user data of its endpoints exceeds 250 bytes: the
hash of the type, the backends of buffers, and for the writer of a single reader the identity of the publisher. Beside
TOPIC are its channels of buffers, each with a writer and a reader: `TOPIC/_buf_cpu` has images too,
`TOPIC/_buf/IDENTITY` has descriptors, which are not CDR of the type. `forgetful`: publishes nothing on TOPIC itself, as
a publisher does after a reader of Lyrical has left while one of another distribution is connected.
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
from cyclonedds.idl.types import int32, sequence, uint8, uint32  # noqa: E402
from cyclonedds.pub import DataWriter  # noqa: E402
from cyclonedds.sub import DataReader  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402

HEIGHT, WIDTH = 48, 64
IDENTITY = "010f27b4c3d2a1900000000000010304"


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@dataclass
class Descriptor(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    handle: str


topic, type_hash, *options = sys.argv[1:]
participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
user_data = f"typehash={type_hash};bufbe=cpu:,cuda:{'device=0 ' * 20};"


def qos(end=""):
    return Qos(
        Policy.Reliability.BestEffort,
        Policy.History.KeepLast(5),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(f"{user_data}{end}".encode()),
    )


def writer(name, kind, end=""):
    return DataWriter(participant, Topic(participant, f"rt{name}", kind), qos=qos(end))


plain, shared = writer(topic, Image), writer(f"{topic}/_buf_cpu", Image)
single = writer(f"{topic}/_buf/{IDENTITY}", Descriptor, f"PGID:{IDENTITY}")
readers = [DataReader(participant, each.topic, qos=qos()) for each in (shared, single)]
number = 0
while True:
    now = time.time_ns()
    header = Header(Time(*divmod(now, 1_000_000_000)), "camera")
    pixels = [(number + index) % 256 for index in range(3 * HEIGHT * WIDTH)]
    image = Image(header, HEIGHT, WIDTH, "rgb8", 0, 3 * WIDTH, pixels)
    (shared if "forgetful" in options else plain).write(image)
    single.write(Descriptor("0"))
    number += 1
    time.sleep(0.1)
