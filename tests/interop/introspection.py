"""Queries types and loggers of a node of the suite, and sets parameters atomically, with a real rclpy; prints JSON.

usage: introspection.py --seconds LIMIT NODE

The answer: what the node says of the type of its /rosout, and what the installation's own files say; the logger levels before and after a change; and what `set_parameters_atomically` made of a change of
which one part is wrong, and of one that is right.
"""

import argparse
import json
import pathlib
import sys

import rclpy
from ament_index_python.packages import get_package_share_directory
from rcl_interfaces.msg import LoggerLevel, Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetLoggerLevels,
    GetParameters,
    GetParameterTypes,
    SetLoggerLevels,
    SetParametersAtomically,
)
from type_description_interfaces.srv import GetTypeDescription

# Every node publishes it, every installation has it, and its description fits into one datagram.
TYPE = "rcl_interfaces/msg/Log"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("node")
    arguments = parser.parse_args()

    rclpy.init()
    node = rclpy.create_node("introspection")

    def call(kind, name, request):
        client = node.create_client(kind, f"{arguments.node}/{name}")
        if not client.wait_for_service(arguments.seconds):
            sys.exit(f"no service {arguments.node}/{name} within {arguments.seconds} s")
        future = client.call_async(request)
        rclpy.spin_until_future_complete(node, future, timeout_sec=arguments.seconds)
        if future.result() is None:
            sys.exit(f"{arguments.node}/{name} did not answer within {arguments.seconds} s")
        return future.result()

    def fields(description):
        return [
            [f.name, f.type.type_id, f.type.capacity, f.type.string_capacity, f.type.nested_type_name]
            for f in description.fields
        ]

    def described(type_name, type_hash):
        request = GetTypeDescription.Request(
            type_name=type_name, type_hash=type_hash, include_type_sources=False
        )
        answer = call(GetTypeDescription, "get_type_description", request)
        description = answer.type_description
        parts = [description.type_description, *description.referenced_type_descriptions]
        return {
            "successful": answer.successful,
            "reason": answer.failure_reason,
            "parts": {part.type_name: fields(part) for part in parts},
        }

    # For a type that both have, hash and description equal those of the installation's generated files.
    share = pathlib.Path(get_package_share_directory("rcl_interfaces"))
    installed = json.loads((share / "msg/Log.json").read_text())
    hashes = {entry["type_name"]: entry["hash_string"] for entry in installed["type_hashes"]}
    message = installed["type_description_msg"]
    keys = ("type_id", "capacity", "string_capacity", "nested_type_name")
    of_installation = {
        part["type_name"]: [[f["name"], *(f["type"][key] for key in keys)] for f in part["fields"]]
        for part in [message["type_description"], *message["referenced_type_descriptions"]]
    }

    def levels():
        names = ["", "wm.encoder", "wm_ros.dds"]
        answer = call(GetLoggerLevels, "get_logger_levels", GetLoggerLevels.Request(names=names))
        return {level.name: level.level for level in answer.levels}

    before = levels()
    wanted = [LoggerLevel(name="wm_ros.dds", level=10), LoggerLevel(name="wm.encoder", level=25)]
    answer = call(SetLoggerLevels, "set_logger_levels", SetLoggerLevels.Request(levels=wanted))
    loggers = {
        "before": before,
        "set": [[result.successful, result.reason] for result in answer.results],
        "after": levels(),
    }

    def integers(name, values):
        value = ParameterValue(type=ParameterType.PARAMETER_INTEGER_ARRAY, integer_array_value=values)
        return Parameter(name=name, value=value)

    def integer(name, number):
        value = ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=number)
        return Parameter(name=name, value=value)

    names = ["steps", "jpeg_quality", "decode_period"]
    changes = [
        [integers("steps", [1, 2]), integer("jpeg_quality", 101)],
        [integers("steps", [1, 2]), integer("decode_period", 1)],
        [integers("steps", [4, 8]), integer("jpeg_quality", 70)],
    ]
    made = []
    for change in changes:
        request = SetParametersAtomically.Request(parameters=change)
        result = call(SetParametersAtomically, "set_parameters_atomically", request).result
        values = call(GetParameters, "get_parameters", GetParameters.Request(names=names)).values
        made.append(
            {
                "successful": result.successful,
                "reason": result.reason,
                "steps": list(values[0].integer_array_value),
                "jpeg_quality": values[1].integer_value,
            }
        )
    types = call(GetParameterTypes, "get_parameter_types", GetParameterTypes.Request(names=names)).types
    descriptors = call(
        DescribeParameters, "describe_parameters", DescribeParameters.Request(names=names)
    ).descriptors
    json.dump(
        {
            "unused": described("std_msgs/msg/Float64", hashes[TYPE]),
            "of_node": described(TYPE, hashes[TYPE]),
            "of_installation": of_installation,
            "loggers": loggers,
            "atomic": made,
            "types": list(types),
            "descriptors": [
                {
                    "read_only": descriptor.read_only,
                    "integers": [[r.from_value, r.to_value] for r in descriptor.integer_range],
                    "doubles": [[r.from_value, r.to_value] for r in descriptor.floating_point_range],
                }
                for descriptor in descriptors
            ],
        },
        sys.stdout,
    )
    print(flush=True)
    node.destroy_node()
    rclpy.shutdown()


main()
