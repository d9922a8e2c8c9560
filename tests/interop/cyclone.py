"""A policy on Eclipse Cyclone DDS, without ROS: receives latents and predictions of the suite, publishes action chunks.

usage: cyclone.py --seconds LIMIT TOPIC:TYPE:COUNT ...

Runs in the ROS domain ROS_DOMAIN_ID on loopback. Each latent is answered by a chunk that begins at its stamp; the values
of its actions are of no other action. Ends when every topic has brought COUNT messages, or after LIMIT seconds. Prints
JSON: "received" as collect.py does, and "chunks".
"""

import argparse
import hashlib
import json
import os
import struct
import sys
import time
from dataclasses import dataclass, fields, is_dataclass

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
from cyclonedds.idl.types import float32, int32, sequence, uint8, uint32, uint64  # noqa: E402
from cyclonedds.pub import DataWriter  # noqa: E402
from cyclonedds.sub import DataReader  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402
from cyclonedds.util import duration  # noqa: E402

CHUNK_LENGTH = 20
PERIOD_NS = 200_000_000


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32

    @classmethod
    def from_ns(cls, ns):
        return cls(*divmod(ns, 1_000_000_000))

    def ns(self):
        return self.sec * 1_000_000_000 + self.nanosec


@dataclass
class Duration(Time, typename="builtin_interfaces::msg::dds_::Duration_"):
    pass


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class LatentSpace(IdlStruct, typename="wm_msgs::msg::dds_::LatentSpace_"):
    name: str
    hash: str


@dataclass
class Latent(IdlStruct, typename="wm_msgs::msg::dds_::Latent_"):
    header: Header
    space: LatentSpace
    height: uint32
    width: uint32
    channels: uint32
    dtype: uint8
    epoch: uint64
    change: float32
    frozen: bool
    data: sequence[uint8]


@dataclass
class Action(IdlStruct, typename="wm_msgs::msg::dds_::Action_"):
    header: Header
    values: sequence[float32]


@dataclass
class Timing(IdlStruct, typename="wm_msgs::msg::dds_::Timing_"):
    capture: Time
    receive: Time
    start: Time
    end: Time


@dataclass
class ActionChunk(IdlStruct, typename="wm_msgs::msg::dds_::ActionChunk_"):
    header: Header
    period: Duration
    actions: sequence[Action]
    timing: Timing


@dataclass
class Prediction(IdlStruct, typename="wm_msgs::msg::dds_::Prediction_"):
    header: Header
    observed_stamp: Time
    step: uint32
    horizon: uint32
    step_period: Duration
    latent: Latent
    actions: sequence[Action]
    epoch: uint64
    model: str
    model_hash: str
    seed: uint64
    integration_steps: uint32
    received_stamp: Time
    ready_stamp: Time


TYPES = {"wm_msgs/msg/Latent": Latent, "wm_msgs/msg/Prediction": Prediction}


def plain(value):
    if isinstance(value, Time):
        return value.ns()
    if is_dataclass(value):
        bytes_of = {field.name for field in fields(value) if field.type == sequence[uint8]}
        return {
            field.name: (
                {"len": len(data := bytes(getattr(value, field.name))), "sha256": hashlib.sha256(data).hexdigest()}
                if field.name in bytes_of
                else plain(getattr(value, field.name))
            )
            for field in fields(value)
        }
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value


def as_float32(value):
    return struct.unpack("<f", struct.pack("<f", value))[0]


def chunk_from(stamp_ns, number):
    """Actions whose dx counts within the chunk and whose dy counts the chunks."""
    stamps = [stamp_ns + index * PERIOD_NS for index in range(CHUNK_LENGTH)]
    actions = [
        Action(
            Header(Time.from_ns(stamp), "base_link"),
            [as_float32(v) for v in (1e-3 * index, 1e-5 * number, 0.0, 0.0, 0.0, 0.0, 0.25)],
        )
        for index, stamp in enumerate(stamps)
    ]
    timing = Timing(*[Time.from_ns(0)] * 4)
    return ActionChunk(Header(Time.from_ns(stamp_ns), "base_link"), Duration.from_ns(PERIOD_NS), actions, timing)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("topics", nargs="+")
    arguments = parser.parse_args()

    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    readers, received, wanted = {}, {}, {}
    for topic in arguments.topics:
        name, type_name, count = topic.split(":")
        qos = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(100))
        readers[name] = DataReader(participant, Topic(participant, f"rt{name}", TYPES[type_name]), qos=qos)
        received[name], wanted[name] = [], int(count)
    writer = DataWriter(
        participant,
        Topic(participant, "rt/wm/action_chunk", ActionChunk),
        qos=Qos(
            Policy.Reliability.Reliable(duration(seconds=1)),
            Policy.History.KeepLast(10),
            Policy.DataRepresentation(use_cdrv0_representation=True),
        ),
    )
    chunks = []
    end = time.monotonic() + arguments.seconds
    while time.monotonic() < end and any(len(received[name]) < wanted[name] for name in wanted):
        for name, reader in readers.items():
            for message in reader.take(N=100):
                received[name].append(plain(message))
                if isinstance(message, Latent):
                    chunks.append(chunk_from(message.header.stamp.ns(), len(chunks)))
                    writer.write(chunks[-1])
        time.sleep(0.01)
    json.dump({"received": received, "chunks": plain(chunks)}, sys.stdout)
    print(flush=True)


main()
