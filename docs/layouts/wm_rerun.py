"""Opens a bag in Rerun: pictures, arm, errors, latencies and the log, side by side.

    pip install rerun-sdk==0.41.0
    python docs/layouts/wm_rerun.py BAG                   # a bag's folder, or one .mcap of it
    python docs/layouts/wm_rerun.py BAG --save OUT.rrd    # without a window: `rerun OUT.rrd` opens it later

Rerun's own reader reads the bag; this program only says what is shown where.
"""

import argparse
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

PICTURES = {
    "Camera": "/camera/image_raw/compressed",
    "Predicted": "/wm/predicted/image/compressed",
    "After the plan": "/wm/plan/image/compressed",
    "Candidates": "/wm/candidates/image/compressed",
    "Goal": "/wm/goal/image/compressed",
}
PLOTS = {
    "Prediction error / persistence (below 1 is better)": [
        "/wm/prediction_error/ratio_k1",
        "/wm/prediction_error/ratio_k4",
        "/wm/prediction_error/ratio_k8",
        "/wm/trust/error_ratio",
    ],
    "Latency of predictions [s]": [
        "/wm/prediction_latency/k1",
        "/wm/prediction_latency/k4",
        "/wm/prediction_latency/k8",
    ],
    "Latent values unlike the training's": ["/wm/trust/unlike_training"],
}
LOG = "/rosout"


def plot(name, topics):
    """A plot of std_msgs/Float64, which Rerun reads as a struct with the field `data`."""
    number = VisualizerComponentMapping(
        "Scalars:scalars",
        ComponentSourceKind.SourceComponent,
        source_component="std_msgs.msg.Float64:message",
        selector=".data",
    )
    line = rr.SeriesLines.from_fields().visualizer(mappings=[number])
    return rrb.TimeSeriesView(name=name, contents=topics, overrides={topic: line for topic in topics})


def blueprint():
    pictures = [rrb.Spatial2DView(name=name, origin=topic) for name, topic in PICTURES.items()]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Grid(*pictures, grid_columns=3),
                # Pictures stay out of the scene: they have views of their own.
                rrb.Spatial3DView(
                    name="Scene", origin="/", contents=["$origin/**", *(f"- {topic}" for topic in PICTURES.values())]
                ),
                row_shares=[3, 2],
            ),
            rrb.Vertical(
                *(plot(name, topics) for name, topics in PLOTS.items()), rrb.TextLogView(name="Log", contents=LOG)
            ),
            column_shares=[3, 2],
        ),
        collapse_panels=True,
    )


def main():
    parser = argparse.ArgumentParser(description="Opens a bag in Rerun.")
    parser.add_argument("bag", type=Path, metavar="BAG", help="a bag's folder, or one .mcap of it")
    parser.add_argument("--save", type=Path, metavar="OUT.rrd", help="write this file instead of opening a window")
    arguments = parser.parse_args()
    files = sorted(arguments.bag.glob("*.mcap")) if arguments.bag.is_dir() else [arguments.bag]
    if not files:
        parser.error(f"no .mcap in {arguments.bag}")

    with rr.RecordingStream("wm", recording_id=arguments.bag.resolve().name) as recording:
        if arguments.save:
            recording.save(arguments.save)
        else:
            recording.spawn()
        recording.send_blueprint(blueprint())
        for file in files:
            recording.log_file_from_path(file)
        recording.flush()


if __name__ == "__main__":
    main()
