"""Clones a policy from bags: python3 train.py BAGS policy.pt [--steps N] [--seed N].

BAGS is a folder of bags with /camera/image_raw/compressed, /wm/action and /task/instruction. Episodes that their
/task/success calls failures are left out. Needs the packages of requirements.txt.
"""

import argparse
import io
import pathlib
import sys

import numpy as np
import torch
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from PIL import Image

from cloned import SIZE, ClonedPolicy, Vocabulary, words

CAMERA, ACTION = "/camera/image_raw/compressed", "/wm/action"
INSTRUCTION, SUCCESS = "/task/instruction", "/task/success"
BATCH = 64
SHIFT = 4  # pixels by which pictures are shifted at most, against learning them by heart


def episode(path):
    """Instruction, success, pictures and the actions after each."""
    pictures, actions, instruction, success = {}, {}, None, True
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        topics = [CAMERA, ACTION, INSTRUCTION, SUCCESS]
        for _, channel, _, message in reader.iter_decoded_messages(topics):
            if channel.topic == INSTRUCTION:
                instruction = message.data
            elif channel.topic == SUCCESS:
                success = message.data
            else:
                stamp = message.header.stamp
                stamp = stamp.sec * 10**9 + stamp.nanosec
                if channel.topic == ACTION:
                    actions[stamp] = np.array(message.values, dtype=np.float32)
                else:
                    picture = Image.open(io.BytesIO(bytes(message.data))).convert("RGB")
                    picture = picture.resize((SIZE, SIZE), Image.Resampling.BOX)
                    pictures[stamp] = np.asarray(picture)
    return instruction, success, [(pictures[stamp], actions[stamp]) for stamp in sorted(pictures.keys() & actions.keys())]


def read(folder):
    pictures, actions, instructions, of = [], [], [], []
    files = sorted(pathlib.Path(folder).rglob("*.mcap"))
    if not files:
        sys.exit(f"{folder} has no bags (*.mcap)")
    for path in files:
        instruction, success, frames = episode(path)
        if instruction is None or not success:
            continue
        for picture, action in frames:
            pictures.append(picture)
            actions.append(action)
            of.append(len(instructions))
        instructions.append(instruction)
    if not pictures:
        sys.exit(f"none of the {len(files)} bags in {folder} has {CAMERA}, {ACTION}, an instruction and a success")
    print(f"{len(instructions)} of {len(files)} episodes, {len(pictures)} frames", flush=True)
    return np.stack(pictures), torch.tensor(np.stack(actions)), instructions, np.array(of)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bags")
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--steps", type=int, default=2000, help=f"of {BATCH} frames")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.out.exists():
        sys.exit(f"{arguments.out} exists already")
    pictures, actions, instructions, of = read(arguments.bags)
    vocabulary = Vocabulary(sorted({word for own in instructions for word in words(own)}))
    texts = torch.stack([vocabulary.encode(own) for own in instructions])
    mean, deviation = actions.mean(0), actions.std(0).clamp(min=1e-6)
    targets = (actions - mean) / deviation

    torch.manual_seed(arguments.seed)
    random = np.random.default_rng(arguments.seed)
    policy = ClonedPolicy(len(vocabulary), actions.shape[1])
    optimiser = torch.optim.AdamW(policy.parameters(), lr=1e-3, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 1e-3, total_steps=arguments.steps)
    recent = []
    for step in range(1, arguments.steps + 1):
        chosen = random.integers(len(pictures), size=BATCH)
        seen = torch.from_numpy(pictures[chosen]).permute(0, 3, 1, 2).float() / 255.0
        padded = torch.nn.functional.pad(seen, [SHIFT] * 4, mode="replicate")
        down, right = random.integers(2 * SHIFT + 1, size=2)
        seen = padded[:, :, down : down + SIZE, right : right + SIZE]
        predicted = policy(seen, texts[of[chosen]])
        loss = torch.nn.functional.smooth_l1_loss(predicted, targets[chosen])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        recent.append(loss.item())
        if step % 100 == 0 or step == arguments.steps:
            print(f"step {step}, loss {np.mean(recent[-100:]):.4f}", flush=True)
    stored = {"weights": policy.state_dict(), "words": vocabulary.known, "mean": mean, "deviation": deviation}
    torch.save(stored, arguments.out)
    print(f"wrote {arguments.out}")


if __name__ == "__main__":
    main()
