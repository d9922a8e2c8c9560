"""Reads a bag with three independent readers (rosbags, mcap, mcap-ros2-support) and prints the results.

    python bags_read.py BAG        BAG: the bag's directory

Every message is decoded too, by rosbags from the schema in the bag and by mcap-ros2-support, and the two are held
against each other. Prints JSON: {"rosbags": [...], "mcap": [...], "qos": {topic: [reliability, durability, depth]},
"counts": {topic: n}}; each list holds [topic, type, log time, sha256 of the CDR] in log-time order.
"""

import hashlib
import json
import sys
from pathlib import Path

import numpy
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore


def sha256(data):
    return hashlib.sha256(bytes(data)).hexdigest()


def plain(value, store):
    """A decoded message as numbers, texts and lists, from either library; `store` has rosbags' types."""
    if hasattr(value, "__msgtype__"):
        _constants, fields = store.fielddefs[value.__msgtype__]
        return {name: plain(getattr(value, name), store) for name, _ in fields}
    if hasattr(value, "__slots__") and not isinstance(value, (str, bytes)):
        return {name: plain(getattr(value, name), store) for name in value.__slots__}
    if isinstance(value, (bytes, bytearray, memoryview)):
        return list(bytes(value))
    if isinstance(value, (list, tuple, numpy.ndarray)):
        return [plain(item, store) for item in value]
    if isinstance(value, numpy.generic):
        return value.item()
    return value


def main(bag):
    by_rosbags, by_mcap, decoded = [], [], []
    with Reader(bag) as reader:
        # Only types that the bag defines: builtin types would hide a wrong schema.
        store = get_typestore(Stores.EMPTY)
        types = {}
        for connection in reader.connections:
            types.update(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        store.register(types)
        qos = {
            connection.topic: [
                [profile.reliability.name.lower(), profile.durability.name.lower(), profile.depth]
                for profile in connection.ext.offered_qos_profiles
            ]
            for connection in reader.connections
        }
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        for connection, time, data in reader.messages():
            by_rosbags.append([connection.topic, connection.msgtype, time, sha256(data)])
            decoded.append(plain(store.deserialize_cdr(data, connection.msgtype), store))

    # A bag of several files: each is complete, and they follow each other in time.
    files = sorted(Path(bag).glob("*.mcap"), key=lambda file: int(file.stem.rsplit("_", 1)[1]))
    for file in files:
        with file.open("rb") as stream:
            for _ in StreamReader(stream, validate_crcs=True).records:
                pass
        with file.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
            assert reader.get_header().profile == "ros2", reader.get_header().profile
            for schema, channel, message, value in reader.iter_decoded_messages(log_time_order=True):
                expected = decoded[len(by_mcap)]
                by_mcap.append([channel.topic, schema.name, message.log_time, sha256(message.data)])
                assert plain(value, store) == expected, (len(by_mcap), plain(value, store), expected)

    print(json.dumps({"rosbags": by_rosbags, "mcap": by_mcap, "qos": qos, "counts": counts}))


if __name__ == "__main__":
    main(sys.argv[1])
