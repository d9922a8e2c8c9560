//! What the arm tells, as messages.

use anyhow::Result;
use image::RgbImage;
use nalgebra::Isometry3;
use wm_camera::image_message::{encode_image, encode_jpeg};
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::{Point, Pose, PoseArray, PoseStamped, Transform, TransformStamped, Vector3},
    sensor_msgs::{CameraInfo, JointState},
    std_msgs::Header,
    tf2_msgs::TFMessage,
    vision_msgs::{LabelInfo, VisionClass},
    wm_msgs::{Action, Goal},
};
use wm_sim::{
    JOINT_NAMES, World,
    render::{Camera, IMAGE_SIZE},
};
use wm_wire::transport::{Pictures, Transports};

use crate::pose::pose_message;

use super::{Done, SimArmStep, Tick, View};

/// As in the simulator's bags.
const JPEG_QUALITY: u8 = 95;

fn header(stamp_ns: i64, frame_id: &str) -> Header {
    Header {
        stamp: Time::from_nanos(stamp_ns),
        frame_id: frame_id.to_owned(),
    }
}

pub(super) fn pictures(
    picture: &RgbImage,
    view: View,
    stamp_ns: i64,
    transports: Transports,
) -> Result<Pictures> {
    let header = || header(stamp_ns, view.frame_id());
    let raw = transports.raw.then(|| encode_image(picture, header()));
    let compressed = transports
        .compressed
        .then(|| encode_jpeg(picture, header(), JPEG_QUALITY));
    Ok(Pictures {
        raw,
        compressed: compressed.transpose()?,
    })
}

pub(super) fn goal(pictures: &[RgbImage], stamp_ns: i64) -> Goal {
    let header = || header(stamp_ns, View::Side.frame_id());
    let images = pictures
        .iter()
        .map(|picture| encode_image(picture, header()));
    Goal {
        header: header(),
        images: images.collect(),
        ..Goal::default()
    }
}

pub(super) fn pose(tick: &Tick, base_frame: &str) -> PoseStamped {
    PoseStamped {
        header: header(tick.stamp_ns, base_frame),
        pose: pose_message(&tick.tool.frame()),
    }
}

pub(super) fn joints(positions: [f64; 8], stamp_ns: i64) -> JointState {
    JointState {
        header: header(stamp_ns, ""),
        name: JOINT_NAMES.map(str::to_owned).to_vec(),
        position: positions.to_vec(),
        velocity: Vec::new(),
        effort: Vec::new(),
    }
}

pub(super) fn action(done: &Done, base_frame: &str) -> Action {
    Action {
        header: header(done.stamp_ns, base_frame),
        values: done.action.values().to_vec(),
    }
}

/// A pinhole camera without distortion.
pub(super) fn camera_info(camera: &Camera, view: View, stamp_ns: i64) -> CameraInfo {
    let focal = camera.focal_px();
    // ROS has 0 in the middle of the first pixel, the simulator at its edge.
    let middle = f64::from(IMAGE_SIZE) / 2.0 - 0.5;
    CameraInfo {
        header: header(stamp_ns, view.frame_id()),
        height: IMAGE_SIZE,
        width: IMAGE_SIZE,
        distortion_model: "plumb_bob".into(),
        d: vec![0.0; 5],
        k: [focal, 0.0, middle, 0.0, focal, middle, 0.0, 0.0, 1.0],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [
            focal, 0.0, middle, 0.0, 0.0, focal, middle, 0.0, 0.0, 0.0, 1.0, 0.0,
        ],
        ..CameraInfo::default()
    }
}

/// Where the tool is, as a frame.
pub(super) fn tool_transform(tick: &Tick, base_frame: &str, tool_frame: &str) -> TFMessage {
    let at = transform(&tick.tool.frame(), tick.stamp_ns, base_frame, tool_frame);
    TFMessage {
        transforms: vec![at],
    }
}

/// Where the cameras are, as frames.
pub(super) fn camera_transforms(step: &SimArmStep, stamp_ns: i64, base_frame: &str) -> TFMessage {
    let of = |(view, camera): (View, &Camera)| {
        let frame = camera.base_from_optical();
        transform(&frame, stamp_ns, base_frame, view.frame_id())
    };
    TFMessage {
        transforms: step.eyes().map(of).collect(),
    }
}

fn transform(
    frame: &Isometry3<f64>,
    stamp_ns: i64,
    frame_id: &str,
    child_frame_id: &str,
) -> TransformStamped {
    let Pose {
        position: Point { x, y, z },
        orientation,
    } = pose_message(frame);
    TransformStamped {
        header: header(stamp_ns, frame_id),
        child_frame_id: child_frame_id.to_owned(),
        transform: Transform {
            translation: Vector3 { x, y, z },
            rotation: orientation,
        },
    }
}

/// Where the objects are, in the order of [`object_names`].
pub(super) fn objects(world: &World, stamp_ns: i64, base_frame: &str) -> PoseArray {
    let objects = world.objects().iter();
    PoseArray {
        header: header(stamp_ns, base_frame),
        poses: objects.map(|object| pose_message(&object.pose)).collect(),
    }
}

/// The objects' names by their places in [`objects`].
pub(super) fn object_names(world: &World, stamp_ns: i64, base_frame: &str) -> LabelInfo {
    let objects = (0..).zip(world.objects());
    LabelInfo {
        header: header(stamp_ns, base_frame),
        class_map: objects
            .map(|(class_id, object)| VisionClass {
                class_id,
                class_name: object.name(),
            })
            .collect(),
        threshold: 0.0,
    }
}
