"""Queries the parameters of a node of the suite by the standard services, with a real rclpy; prints JSON.

usage: parameters.py --seconds LIMIT NODE [--set NAME=YAML ...]

The answer: every parameter's value, description and read-only mark, and what the node said to each `--set`.
"""

import argparse
import json
import sys

import rclpy
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("node")
    parser.add_argument("--set", action="append", default=[])
    arguments = parser.parse_args()

    rclpy.init()
    node = rclpy.create_node("parameters")
    client = AsyncParameterClient(node, arguments.node)
    if not client.wait_for_services(arguments.seconds):
        sys.exit(f"no parameter services of {arguments.node} within {arguments.seconds} s")

    def answer(future):
        rclpy.spin_until_future_complete(node, future, timeout_sec=arguments.seconds)
        if future.result() is None:
            sys.exit(f"{arguments.node} did not answer within {arguments.seconds} s")
        return future.result()

    names = answer(client.list_parameters([], 10)).result.names
    values = answer(client.get_parameters(names)).values
    descriptors = answer(client.describe_parameters(names)).descriptors
    sets = []
    for assignment in arguments.set:
        name, text = assignment.split("=", 1)
        value = json.loads(text)
        result = answer(client.set_parameters([Parameter(name, value=value)])).results[0]
        sets.append({"successful": result.successful, "reason": result.reason})
    json.dump(
        {
            "parameters": {
                name: {
                    "value": parameter_value_to_python(value),
                    "description": descriptor.description,
                    "read_only": descriptor.read_only,
                }
                for name, value, descriptor in zip(names, values, descriptors)
            },
            "sets": sets,
        },
        sys.stdout,
        default=list,
    )
    print(flush=True)
    node.destroy_node()
    rclpy.shutdown()


main()
