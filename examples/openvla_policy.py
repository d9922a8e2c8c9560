"""OpenVLA-7B (openvla/openvla-7b, arXiv 2406.09246) as a policy: images and an instruction in, Bridge V2 actions out.

usage: python examples/openvla_policy.py [--model openvla/openvla-7b] [--instruction TEXT]

It needs ROS 2 with wm_msgs; torch, transformers==4.40.1, tokenizers==0.19.1, timm==0.9.10, pillow and numpy from PyPI
(the checkpoint's versions); 16 GB of GPU memory; and the checkpoint (`huggingface-cli download`). The
instruction comes from /task/instruction, which `wm env` publishes, unless --instruction gives one.

The functions that need no weights, `prompt`, `prepare`, `normalized` and `unnormalize`, import only numpy and pillow.
"""

import io

import numpy as np

STATISTICS = "bridge_orig"  # the dataset whose action statistics scale the output
BINS = 256  # bins per action dimension, from -1 to 1; tokens count down from the end of the vocabulary
SIDE = 224  # height and width of the model's input [px]


def prompt(instruction):
    """The prompt that the model was trained with; its instructions were lower-case."""
    return f"In: What action should the robot take to {instruction.strip().lower()}?\nOut:"


def prepare(data, center_crop=False):
    """A compressed image's bytes as the model's input: a PIL image, RGB, SIDE x SIDE.

    `center_crop` keeps the middle 90 % of the area, for checkpoints that were fine-tuned with random crops.
    """
    from PIL import Image

    picture = Image.open(io.BytesIO(bytes(data))).convert("RGB")
    if center_crop:
        width, height = (side * 0.9**0.5 for side in picture.size)
        left, top = (picture.width - width) / 2, (picture.height - height) / 2
        box = tuple(round(value) for value in (left, top, left + width, top + height))
        picture = picture.crop(box)
    return picture.resize((SIDE, SIDE), Image.Resampling.LANCZOS)


def normalized(tokens, vocabulary):
    """The model's last tokens as actions in -1 to 1: the centres of the bins, one fewer than there are edges."""
    edges = np.linspace(-1.0, 1.0, BINS)
    centres = (edges[:-1] + edges[1:]) / 2.0
    return centres[np.clip(vocabulary - np.asarray(tokens) - 1, 0, len(centres) - 1)]


def unnormalize(action, statistics):
    """The physical action: dx dy dz [m], droll dpitch dyaw [rad], gripper 0 closed to 1 open.

    `statistics` is the checkpoint's `norm_stats[STATISTICS]["action"]`. -1 and 1 map to q01 and q99 of each dimension;
    dimensions whose `mask` is false do not change (the gripper is 0 to 1 already).
    """
    action = np.asarray(action, dtype=np.float64)
    low, high = (np.asarray(statistics[key], dtype=np.float64) for key in ("q01", "q99"))
    mask = np.asarray(statistics.get("mask", np.ones_like(low)), dtype=bool)
    if not action.shape == low.shape == high.shape == mask.shape:
        raise ValueError(f"an action of {action.shape} values for statistics of {low.shape}, {high.shape}, {mask.shape}")
    if not np.isfinite(action).all():
        raise ValueError(f"an action that is not finite: {action}")
    physical = np.where(mask, 0.5 * (action + 1.0) * (high - low) + low, action)
    physical[-1] = np.clip(physical[-1], 0.0, 1.0)
    return physical.astype(np.float32)


class OpenVla:
    """OpenVLA with its weights."""

    def __init__(self, name):
        import torch
        from transformers import AutoModelForVision2Seq, AutoProcessor

        self.device = "cuda" if torch.cuda.is_available() else "cpu"
        self.dtype = torch.bfloat16
        # The checkpoint brings its own Python code: read it before you trust it.
        self.processor = AutoProcessor.from_pretrained(name, trust_remote_code=True)
        self.model = AutoModelForVision2Seq.from_pretrained(
            name, torch_dtype=self.dtype, low_cpu_mem_usage=True, trust_remote_code=True
        ).to(self.device)
        self.statistics = self.model.norm_stats[STATISTICS]["action"]
        self.vocabulary = self.model.config.text_config.vocab_size - self.model.config.pad_to_multiple_of

    def predict(self, data, instruction):
        import torch

        inputs = self.processor(prompt(instruction), prepare(data)).to(self.device, dtype=self.dtype)
        # 29871 is the token of a space, which ended every training prompt.
        if not torch.all(inputs["input_ids"][:, -1] == 29871):
            space = torch.tensor([[29871]], device=self.device)
            inputs["input_ids"] = torch.cat((inputs["input_ids"], space), dim=1)
            inputs["attention_mask"] = torch.cat((inputs["attention_mask"], torch.ones_like(space)), dim=1)
        count = len(self.statistics["q01"])
        with torch.inference_mode():
            tokens = self.model.generate(**inputs, max_new_tokens=count, do_sample=False)[0, -count:]
        return unnormalize(normalized(tokens.cpu().numpy(), self.vocabulary), self.statistics)


def main():
    import argparse

    import rclpy
    from builtin_interfaces.msg import Duration
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import CompressedImage
    from std_msgs.msg import String
    from wm_msgs.msg import Action, ActionChunk

    parser = argparse.ArgumentParser()
    parser.add_argument("--model", default="openvla/openvla-7b")
    parser.add_argument("--instruction", default="")
    arguments = parser.parse_args()
    policy = OpenVla(arguments.model)

    rclpy.init()
    node = rclpy.create_node("openvla_policy")
    chunks = node.create_publisher(ActionChunk, "/wm/action_chunk", 10)
    instruction = arguments.instruction

    def listen(text):
        nonlocal instruction
        instruction = arguments.instruction or text.data

    def act(image):
        if not instruction:
            node.get_logger().warn("no instruction yet on /task/instruction", throttle_duration_sec=5.0)
            return
        now = node.get_clock().now().to_msg
        chunk = ActionChunk(header=image.header, period=Duration(nanosec=200_000_000))
        chunk.timing.capture, chunk.timing.receive, chunk.timing.start = image.header.stamp, now(), now()
        values = policy.predict(image.data, instruction)
        chunk.header.frame_id = "base_link"
        chunk.actions = [Action(header=chunk.header, values=values.tolist())]
        chunk.timing.end = now()
        chunks.publish(chunk)

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)
    node.create_subscription(String, "/task/instruction", listen, latched)
    # Only the newest image: an answer to an older one would be too late.
    newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(CompressedImage, "/camera/image_raw/compressed", act, newest)
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
