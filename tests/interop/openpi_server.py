"""An openpi policy server without a model: the published protocol, by openpi_client's own encoding and websockets.

usage: openpi_server.py PORT

Answers show the observation: row i of the eight actions is [i, red, green, blue at the middle of the picture's left half,
state 0, state 1, length of the prompt]. These prompts get other answers: "nan", "short" (six values), "slow" (3 s late),
"error" (a text, and the end of the connection), "silence" (none).
"""

import asyncio
import sys

import numpy as np
import websockets.asyncio.server
from openpi_client import msgpack_numpy


async def answer(observation):
    picture, state, prompt = (observation[key] for key in ("observation/image", "observation/state", "prompt"))
    if (picture.dtype, picture.shape, state.dtype) != (np.uint8, (224, 224, 3), np.float32):
        raise ValueError(f"a picture {picture.dtype} {picture.shape}, a state {state.dtype}")
    if picture[0].any():
        raise ValueError("the picture is four to three: its first rows are padding")
    if prompt == "error":
        raise ValueError("an error of the policy")
    await asyncio.sleep({"slow": 3.0, "silence": 3600.0}.get(prompt, 0.0))
    row = [0.0, *picture[112, 56], *state, float(len(prompt))]
    actions = np.array([[index, *row[1:]] for index in range(8)], dtype=np.float32)
    if prompt == "nan":
        actions[3, 2] = np.nan
    return {"actions": actions[:, :6] if prompt == "short" else actions, "server_timing": {"infer_ms": 0.0}}


async def serve(connection):
    await connection.send(msgpack_numpy.packb({"policy": "none"}))
    async for message in connection:
        try:
            await connection.send(msgpack_numpy.packb(await answer(msgpack_numpy.unpackb(message))))
        except ValueError as error:
            await connection.send(f"Traceback: {error}")
            await connection.close(1011)
            return


async def main():
    options = {"compression": None, "max_size": None}
    async with websockets.asyncio.server.serve(serve, "localhost", int(sys.argv[1]), **options) as server:
        await server.serve_forever()


asyncio.run(main())
