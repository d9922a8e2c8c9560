"""A policy of an openpi server (scripts/serve_policy.py: pi0, pi0.5) on /wm/action_chunk.

usage: python examples/openpi_policy.py --rate HZ [--server ws://HOST:8000] ...        (--help lists all)

It needs ROS 2 with wm_msgs, and from PyPI openpi-client==0.1.2, typing_extensions and pillow. A checkpoint for LIBERO,
whose actions are fractions of 0.05 m and 0.5 rad, with a gripper from -1 (open) to 1 (closed):

    python examples/openpi_policy.py --rate 20 --image observation/image=/camera/image_raw \\
        --image observation/wrist_image=/wrist/image_raw --state observation/state=x,y,z,rx,ry,rz,finger_1,finger_2 \\
        --action 'dx*0.05,dy*0.05,dz*0.05,droll*0.5,dpitch*0.5,dyaw*0.5,gripper*-0.5+0.5'

The environment variable OPENPI_API_KEY is the key of a server that requires one; use wss:// with it.
"""

import os

from openpi_client.image_tools import resize_with_pad
from openpi_client.websocket_client_policy import WebsocketClientPolicy
from policy_bridge import Refusal, number, parse, parser, run


def main():
    options = parser(__doc__, server="ws://localhost:8000", image="observation/image=/camera/image_raw")
    options.add_argument("--size", type=number(int, 1), default=224, help="side of the pictures [px] (%(default)s)")
    options.add_argument("--prompt", default="prompt", metavar="KEY", help="key of the instruction (%(default)s)")
    arguments = parse(options)

    def connect(_):
        client = WebsocketClientPolicy(arguments.server, api_key=os.environ.get("OPENPI_API_KEY"))

        def infer(observation):
            side = arguments.size
            pictures = {key: resize_with_pad(picture, side, side) for key, picture in observation.pictures.items()}
            answer = client.infer({**pictures, **observation.states, arguments.prompt: observation.instruction})
            if not isinstance(answer, dict) or "actions" not in answer:
                raise Refusal("shape", f"expected an answer with 'actions', found {str(answer)[:200]}")
            return answer["actions"]

        return infer

    run("openpi_policy", arguments, connect)


if __name__ == "__main__":
    main()
