"""A Zenoh client of the bridge: peer.py ENDPOINT COMMAND ...; payloads and output are hexadecimal.

subscribe KEY         prints the first sample of the key
publish KEY PAYLOAD   publishes until it is told to end by its standard input's
call KEY [PAYLOAD]    prints the answer to a query
announced KIND        prints the liveliness tokens of the bridges of this kind (MP, MS, SS, SC), one a line
serve KEY TYPE        serves a service as the other bridge would: prints a request and its attachment, and answers with
                      the request
"""

import json
import queue
import sys
import time

import zenoh

PATIENCE_S = 30


def hexadecimal(payload):
    return bytes(payload).hex() if payload is not None else ""


def subscribe(session, key):
    samples = queue.Queue()
    _subscriber = session.declare_subscriber(key, samples.put)
    print(hexadecimal(samples.get(timeout=PATIENCE_S).payload), flush=True)


def publish(session, key, payload):
    publisher = session.declare_publisher(key)
    deadline = time.monotonic() + PATIENCE_S
    while not publisher.matching_status.matching:
        if time.monotonic() > deadline:
            sys.exit(f"nobody subscribes to {key}")
        time.sleep(0.02)
    publisher.put(bytes.fromhex(payload))
    sys.stdin.read()


def call(session, key, payload=None):
    querier = session.declare_querier(key, timeout=PATIENCE_S)
    deadline = time.monotonic() + PATIENCE_S
    while not querier.matching_status.matching:
        if time.monotonic() > deadline:
            sys.exit(f"nobody serves {key}")
        time.sleep(0.02)
    request = None if payload is None else bytes.fromhex(payload)
    for reply in querier.get(payload=request):
        if reply.ok is not None:
            print(hexadecimal(reply.ok.payload), flush=True)
        else:
            print("error " + reply.err.payload.to_string(), flush=True)


def announced(session, kind):
    keys = f"@/*/@ros2_lv/{kind}/**"
    for reply in session.liveliness().get(keys, timeout=PATIENCE_S):
        if reply.ok is not None:
            print(reply.ok.key_expr, flush=True)


def serve(session, key, type_name):
    queries = queue.Queue()
    _queryable = session.declare_queryable(key, queries.put)
    escaped = [part.replace("/", "§") for part in (key, type_name)]
    _token = session.liveliness().declare_token(f"@/{session.info.zid()}/@ros2_lv/SS/{'/'.join(escaped)}")
    query = queries.get(timeout=PATIENCE_S)
    print(hexadecimal(query.payload), hexadecimal(query.attachment), flush=True)
    query.reply(key, query.payload)
    query.drop()
    sys.stdin.read()


def main():
    endpoint, command, *rest = sys.argv[1:]
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    # The bridge may not be listening yet.
    config.insert_json5("connect/timeout_ms", str(1000 * PATIENCE_S))
    config.insert_json5("scouting/multicast/enabled", "false")
    commands = {f.__name__: f for f in (subscribe, publish, call, announced, serve)}
    with zenoh.open(config) as session:
        commands[command](session, *rest)


main()
