"""A program with zenoh-ros2-sdk, which implements the wire format of rmw_zenoh without ROS.

usage: sdk.py ENDPOINT COMMAND NAME [QOS]

echo    prints "ready", then the length and the first letters of every text on a topic
say     publishes the lines of its input on a topic: "LENGTH LETTER" is a text of that letter
serve   serves a std_srvs/srv/SetBool until its input ends
call    calls a std_srvs/srv/SetBool with each line of its input, "true" or "false"
graph   prints the endpoints of a topic as JSON
"""

import json
import sys

import zenoh_ros2_sdk as sdk

TEXT = {"msg_type": "std_msgs/msg/String", "msg_definition": "string data"}
SET_BOOL = {
    "srv_type": "std_srvs/srv/SetBool",
    "request_definition": "bool data",
    "response_definition": "bool success\nstring message",
}


def lines():
    return (line.strip() for line in sys.stdin)


def main():
    endpoint, command, name, *qos = sys.argv[1:]
    host, port = endpoint.removeprefix("tcp/").rsplit(":", 1)
    router = {"router_ip": host, "router_port": int(port)}
    if qos:
        router["qos"] = qos[0]

    if command == "echo":

        def received(message):
            print(len(message.data), message.data[:8], flush=True)

        subscriber = sdk.ROS2Subscriber(name, callback=received, **TEXT, **router)
        print("ready", flush=True)
        for _ in lines():
            pass
        subscriber.close()
    elif command == "say":
        publisher = sdk.ROS2Publisher(name, **TEXT, **router)
        print("ready", flush=True)
        for line in lines():
            length, letter = line.split()
            publisher.publish(data=letter * int(length))
        publisher.close()
    elif command == "serve":

        def serve(request):
            response = server.response_msg_class
            return response(success=True, message=f"was {request.data}".lower())

        server = sdk.ROS2ServiceServer(name, callback=serve, **SET_BOOL, **router)
        print("ready", flush=True)
        for _ in lines():
            pass
        server.close()
    elif command == "call":
        client = sdk.ROS2ServiceClient(name, **SET_BOOL, **router)
        print("ready", flush=True)
        for line in lines():
            answer = client.call(data=line == "true")
            print(answer.success, answer.message, flush=True)
        client.close()
    elif command == "graph":
        # discovery takes a moment
        for _ in range(20):
            info = sdk.get_topic_info(name, verbose=True, **router)
            if info:
                break
        print(json.dumps(info, default=vars))
    else:
        raise SystemExit(f"unknown command {command}")


main()
